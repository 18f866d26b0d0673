"""Pillar deflection and force-strain loops against exact truth: the table "Pillars" of docs/benchmarks.md.

    python benchmarks/pillar_truth.py

The movies are finite-element bundles on elastic pillars. Such a bundle is elastic, so that its true loop has hardly an
area: the error of the loop is given as a share of the rectangle around it, peak force x peak strain. The truth goes
through the same definitions (`microbundle.force`) as the measurement: the pillars' true motion is the mean displacement
of the points of their mask, the true strain is fitted to the true displacement of dense points in the analysis's own
sub-domains. Errors are those of the worst whole beat; the interval is that of 95 % by the standard error of each beat
and pillar. Pillars are given by their masks (`supplied`), or found (`auto`).
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from microbundle import Analysis, Config, analyze, tables
from microbundle.data import Floats, PillarMotion, Strain
from microbundle.force import forces, loop_areas
from microbundle.levels import level_values
from microbundle.strain import fit_gradient
from microbundle.synth.cases import Case, camera, case_set, perlin
from microbundle.synth.noise import NoiseModel
from microbundle.synth.render import SyntheticMovie

SETTINGS = {"pillars": {"stiffness_un_per_um": 1.0}}
STEP_PX = 2
T_95 = 2.04


def cases() -> dict[str, Case]:
    """Movies by name."""
    scenes = {c.name: c for c in case_set("paper") if c.name in ("homogeneous-X-1", "heterogeneous-X-1")}
    noises = {"clean": NoiseModel(), "camera": camera(11), "Perlin 6 %": perlin(0.06, 28, 512, 12)}
    return {f"{name}, {noise}": replace(case, noise=model)
            for name, case in scenes.items() for noise, model in noises.items()}


def true_motion(synthetic: SyntheticMovie, analysis: Analysis) -> PillarMotion:
    """The pillars of an analysis where they truly are."""
    motion = analysis.pillars
    assert motion is not None
    shift = np.empty(motion.shift_px.shape)
    for p, mask in enumerate(synthetic.pillars):
        points = np.argwhere(mask)[::STEP_PX**2].astype(float)
        for t in range(len(shift)):
            shift[t, p] = synthetic.truth.displacement_px(points, t).mean(axis=0)
    return replace(motion, shift_px=shift, shift_se_px=np.zeros(shift.shape))


def true_strain(synthetic: SyntheticMovie, strain: Strain) -> Floats:
    """True mean E_cc (T,) over the sub-domains, less its value at rest."""
    share = (np.arange(9) + 0.5) / 9
    angle = np.deg2rad(strain.angle_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    count, parts = strain.F.shape[:2]
    out = np.full((count, parts), np.nan)
    for s in np.flatnonzero(np.isfinite(strain.F).all(axis=(0, 2, 3))):
        corner = strain.corner_px[s]
        down, right = corner[3] - corner[0], corner[1] - corner[0]
        X = (corner[0] + share[:, None, None] * down + share[None, :, None] * right).reshape(-1, 2)
        u = np.stack([synthetic.truth.displacement_px(X, t) for t in range(count)])
        F = fit_gradient(X @ turn.T, (X + u) @ turn.T)[0]
        out[:, s] = 0.5 * (np.einsum("tki,tkj->tij", F, F) - np.eye(2))[:, 1, 1]
    return np.asarray(np.nanmean(out, axis=1))


def line(name: str, synthetic: SyntheticMovie, masks: str) -> str:
    """One line of the table."""
    movie = synthetic.movie
    if masks == "supplied":
        movie = replace(movie, supplied_masks={f"pillar_{k}": m for k, m in enumerate(synthetic.pillars, start=1)})
    analysis = analyze(movie, Config.from_dict(SETTINGS))
    if analysis.pillars is None or len(analysis.pillars.pillars) != 2:
        return f"| {name} | {masks} | no pillars | | | |"
    whole = analysis.beats.complete
    truth = replace(analysis, pillars=true_motion(synthetic, analysis))
    found, true = (level_values(a, nulls=False)["pillar"]["deflection"][whole] for a in (analysis, truth))
    table = tables(analysis)["pillars"].query("complete")
    error = np.asarray(table["deflection_se_px"]).reshape(found.shape)
    held = float((np.abs(found - true) < T_95 * error).mean())
    wrong = 100 * (found / true - 1)
    loops = ["", ""]
    if analysis.strain is not None:
        E_cc = analysis.strain.E[..., 1, 1]
        usable = np.isfinite(E_cc).all(axis=0)
        area = loop_areas(analysis, -E_cc[:, usable].mean(axis=1), _force(analysis))[whole]
        exact = loop_areas(analysis, -true_strain(synthetic, analysis.strain), _force(truth))[whole]
        scale = np.ptp(true_strain(synthetic, analysis.strain)) * np.ptp(_force(truth))
        loops = [f"{100 * np.abs(exact).mean() / scale:.1f}",
                 f"{100 * np.abs(area - exact).max() / scale:.2f}"]
    return (f"| {name} | {masks} | {true.mean(axis=0)[0]:.2f}, {true.mean(axis=0)[1]:.2f} | "
            f"{wrong[np.unravel_index(np.abs(wrong).argmax(), wrong.shape)]:+.2f} | {100 * held:.0f} | "
            f"{' | '.join(loops)} |")


def _force(analysis: Analysis) -> Floats:
    found = forces(analysis)
    assert found is not None
    return np.asarray(found.along_px.mean(axis=1))


def main() -> None:
    wanted = sys.argv[1:]
    print("| movie | masks | true deflection, px | worst error, % | held by 95 % interval, % | loop area, % of force x "
          "strain | its worst error, same % |\n|---|---|---|---|---|---|---|")
    for name, case in cases().items():
        if wanted and not any(w in name for w in wanted):
            continue
        synthetic = case.make().drawn()
        for masks in ("supplied", "auto"):
            print(line(name, synthetic, masks), flush=True)


if __name__ == "__main__":
    main()
