"""Measure the finite-element truth: python benchmarks/tissue_mechanics.py [--fine] [--figures FOLDER]

Prints one table: free contraction, tangent against finite differences, volume, pillars against beam theory,
convergence over meshes, the spline in the activation, the smooth surface against the elements, and times. Set
OMP_NUM_THREADS=1 for times that compare. `--fine` adds the finest mesh (minutes); the others need about a minute.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from microbundle.synth.activation import Fibres, clipped_cosine
from microbundle.synth.equilibrium import Assembly, solve_levels
from microbundle.synth.material import PillarLaw, TissueLaw, active_tensor
from microbundle.synth.membrane import ALIGNED, FIBROUS, fibrous_sheet, solve_membrane
from microbundle.synth.mesh import extrude, triangulate
from microbundle.synth.outline import Bundle, Pillar, bundle_mask
from microbundle.synth.solution import TissueSolution
from microbundle.synth.tissue import LEVELS, passive, solid_body, solve_tissue

UM_PER_PX = 4.0


def free_block(g: float = 0.08) -> dict[str, float]:
    """Let a block that nothing holds contract; the stretch along its fibres should be 1 - g, its stress zero."""
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    outline = np.stack([200 * np.sin(angle), 500 * np.cos(angle)], axis=1)
    mesh = extrude(triangulate(Bundle(outline, ()), 150.0), np.linspace(0, 300, 3), [])
    fibres, law = Fibres(12.0, 12.0), TissueLaw()

    def structure(at):  # type: ignore[no-untyped-def]
        f = fibres.direction(at, at.min(axis=(0, 1)), at.max(axis=(0, 1)))
        return lambda gamma: active_tensor(f, np.full(at.shape[:-1], gamma))

    cells, body = solid_body(mesh, [(0, law, structure)])
    corner = np.flatnonzero(cells.node_um[:, 2] == 0)
    a, b = corner[cells.node_um[corner, 1].argmin()], corner[cells.node_um[corner, 1].argmax()]
    c = corner[cells.node_um[corner, 0].argmax()]
    body.fixed[a], body.fixed[b, [0, 2]], body.fixed[c, 2] = True, True, True
    solved = solve_levels(body, [g])
    x = np.concatenate([solved.displacement_um[-1].ravel(), solved.pressure_mpa[-1]])
    F, p, A = Assembly(body).residual(x, g)[1][0]
    f = fibres.direction(cells.at_um, cells.at_um.min(axis=(0, 1)), cells.at_um.max(axis=(0, 1)))
    stretch = np.linalg.norm((F @ f[..., None])[..., 0], axis=-1)
    return {"stretch error": float(np.abs(stretch - (1 - g)).max()),
            "largest stress / mu": float(np.abs(law.stress(F, p, A)).max() / law.mu_mpa)}


def tangent_error() -> float:
    """Compare the assembled tangent with central differences of the residual along random directions."""
    bundle = Bundle.from_mask(bundle_mask((300, 512), UM_PER_PX), UM_PER_PX)
    mesh = extrude(triangulate(bundle, 200.0), np.linspace(0, 400, 2), [np.array([400.0, 700.0, 995.0])] * 2)

    def structure(at):  # type: ignore[no-untyped-def]
        f = Fibres().direction(at, at.min(axis=(0, 1)), at.max(axis=(0, 1)))
        return lambda gamma: active_tensor(f, np.full(at.shape[:-1], gamma))

    _, body = solid_body(mesh, [(0, TissueLaw(), structure), (1, PillarLaw(), passive), (2, PillarLaw(), passive)])
    assembly, random = Assembly(body), np.random.default_rng(0)
    x = np.concatenate([random.normal(0, 1.0, body.nodes * 3), random.normal(0, 1e-3, body.pressures)])
    K = assembly.tangent(assembly.residual(x, 0.05)[1])
    v = random.normal(size=assembly.size)
    v[body.nodes * 3:] *= 1e-3
    eps = 1e-5
    slope = (assembly.residual(x + eps * v, 0.05)[0] - assembly.residual(x - eps * v, 0.05)[0]) / (2 * eps)
    worst = 0.0
    for part in (slice(0, body.nodes * 3), slice(body.nodes * 3, None)):
        worst = max(worst, float(np.linalg.norm((K @ v - slope)[part]) / np.linalg.norm(slope[part])))
    return max(worst, float(abs(K - K.T).max() / abs(K).max()))


def cantilever(diameter_um: float = 150.0, length_um: float = 1000.0, spacing_um: float = 39.0) -> dict[str, float]:
    """Pull the end of a clamped round pillar and compare with Timoshenko's beam (shear factor after Cowper 1966)."""
    pillar = Pillar((0.0, 0.0), (diameter_um, diameter_um))
    ring = pillar.polygon_um(spacing_um)
    side = float(np.hypot(*(ring[1] - ring[0])))
    mesh = extrude(triangulate(Bundle(ring, ()), side), np.linspace(0, length_um, 14), [])
    law = PillarLaw()
    cells, body = solid_body(mesh, [(0, law, passive)])
    body.fixed[cells.node_um[:, 2] > length_um * (1 - 1e-9)] = True
    force = 0.01
    load = np.zeros_like(cells.node_um)
    end = cells.node_um[:, 2] == 0
    load[end, 1] = force / end.sum()
    solved = solve_levels(replace(body, load_un=load), [])
    found = float(solved.displacement_um[0, end, 1].mean())
    EI = law.young_mpa * pillar.second_moment_um4(1)
    bend, shear = force * length_um**3 / (3 * EI), force * length_um / _shear(pillar, law)
    return {"found um": found, "Timoshenko um": bend + shear, "share": found / (bend + shear)}


def coupled_beam(solution: TissueSolution, level: int = -1) -> list[float]:
    """Compare each shaft's deflection under the tissue with beam theory for the force and moment at its base."""
    h = float(solution.facts["thickness_um"])
    shares = []
    for k, pillar in enumerate(solution.pillars):
        law = PillarLaw(pillar.young_mpa, pillar.poisson)
        mine = np.unique(solution.cell[solution.region == k + 1])
        shaft_top = mine[np.abs(solution.node_um[mine, 2] - h) < 1e-6]
        found = solution.displacement_um[level, shaft_top, 1].mean()
        F, M = solution.force_un[level, k, 1], solution.moment_un_um[level, k, 1]
        L, EI = pillar.shaft_um, pillar.young_mpa * pillar.second_moment_um4(1)
        beam = F * L**3 / (3 * EI) + (M - F * L) * L**2 / (2 * EI) + F * L / _shear(pillar, law)
        shares.append(float(found / beam))
    return shares


def _shear(pillar: Pillar, law: PillarLaw) -> float:
    nu = law.poisson
    return 6 * (1 + nu) / (7 + 6 * nu) * law.lame_mpa[0] * pillar.area_um2


def spline_error(solution: TissueSolution, bundle: Bundle, g: float = 0.05) -> float:
    """Solve one more activation and give the largest error (um) of the spline between the others."""
    from scipy.interpolate import CubicSpline
    more = solve_tissue(bundle, resolution=solution.facts["resolution"], levels=[g / 2, g])
    between = CubicSpline(solution.activation, solution.displacement_um)(g)
    return float(np.abs(between - more.displacement_um[-1]).max())


def compare(a: TissueSolution, b: TissueSolution) -> float:
    """Relative difference of the upper surface's displacement at peak, on points of the waist and the ends."""
    px = np.argwhere(bundle_mask((300, 512), UM_PER_PX)).astype(float)[::37]
    at = [s.motion(np.array([0.08]), UM_PER_PX).displacement_px(px, 0) for s in (a, b)]
    return float(np.linalg.norm(at[0] - at[1]) / np.linalg.norm(at[1]))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fine", action="store_true")
    parser.add_argument("--figures", type=Path)
    options = parser.parse_args()

    def row(name: str, value: object) -> None:
        print(f"| {name} | {value} |", flush=True)

    print("| what | measured |\n|---|---|")
    for name, value in free_block().items():
        row(f"free block, {name}", f"{value:.1e}")
    row("tangent against differences, relative", f"{tangent_error():.1e}")
    for name, value in cantilever().items():
        row(f"slender pillar, {name}", f"{value:.4f}")

    bundle = Bundle.from_mask(bundle_mask((300, 512), UM_PER_PX), UM_PER_PX)
    solutions = {}
    for resolution in ("coarse", "medium", "fine")[: 3 if options.fine else 2]:
        s = solutions[resolution] = solve_tissue(bundle, resolution=resolution)  # type: ignore[arg-type]
        start = time.process_time()
        motion = s.motion(clipped_cosine(200, seed=100), UM_PER_PX)
        px = np.argwhere(np.ones((300, 200), bool)) + np.array([0.0, 156.0])
        for frame in range(motion.count):
            motion.displacement_px(px, frame)
        movie = time.process_time() - start
        peak = list(s.activation).index(0.08)
        row(f"{resolution}: unknowns, cells", f"{s.log.unknowns}, {len(s.cell)}")
        row(f"{resolution}: CPU s to solve; 200 frames of 60,000 points", f"{s.facts['seconds']:.1f}; {movie:.1f}")
        row(f"{resolution}: iterations; last residual uN", f"{s.log.iterations.tolist()}; "
            f"{np.nanmin(s.log.residual_un, axis=1).max():.1e}")
        row(f"{resolution}: mean J - 1, worst J, both over all levels", f"{s.mean_J_error:.1e}, {s.worst_J:.3f}")
        row(f"{resolution}: head (um) and force (uN) along col at 0.08",
            f"{s.head_um[peak, :, 1].round(3)}, {s.force_un[peak, :, 1].round(2)}")
        row(f"{resolution}: shaft deflection / beam theory", np.round(coupled_beam(s), 3))
        f = s.surface
        row(f"{resolution}: smooth surface - elements: max, rms um; rms F; jump of F",
            f"{f.gap_um:.2f}, {f.gap_rms_um:.3f}; {f.gap_F:.4f}; {f.jump_F:.4f}")
    names = list(solutions)
    for name in names[:-1]:
        row(f"displacement at peak, {name} against {names[-1]}",
            f"{compare(solutions[name], solutions[names[-1]]):.4f}")
    row("spline in the activation, worst error at 0.05 (um)", f"{spline_error(solutions['coarse'], bundle):.1e}")

    flat = solve_membrane(bundle)
    row("membrane: unknowns, CPU s, s per solve", f"{flat.log.unknowns}, {flat.facts['seconds']:.2f}, "
        f"{flat.log.seconds.mean():.2f}")
    sheet = solve_membrane(fibrous_sheet(), fibres=ALIGNED, law=FIBROUS)
    peak = list(LEVELS).index(0.08)
    row("fibrous sheet: head um, force uN at 0.08", f"{sheet.head_um[peak, :, 1].round(3)}, "
        f"{sheet.force_un[peak, :, 1].round(3)}")
    if options.figures:
        options.figures.mkdir(parents=True, exist_ok=True)
        for name, s in {**solutions, "membrane": flat, "sheet": sheet}.items():
            draw(s, options.figures / f"tissue_{name}.png")


def draw(solution: TissueSolution, path: Path, g: float = 0.08) -> None:
    """Draw the upper surface at peak: displacement along col and E_cc, moved by the displacement."""
    from matplotlib.figure import Figure
    level = int(np.abs(solution.activation - g).argmin())
    u = solution.displacement_um[level]
    at = solution.node_um[:, :2] + u[:, :2]
    part = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
    tissue = solution.top[solution.top_region == 0][:, part].reshape(-1, 3)
    E = np.full(len(at), np.nan)
    E[solution.strain_node] = solution.strain[level, :, 1, 1]
    figure = Figure(figsize=(12, 10))
    for axes, value, name in zip(figure.subplots(2), (u[:, 1], E), ("u_c (um)", "E_cc"), strict=True):
        shade = axes.tripcolor(at[:, 1], at[:, 0], tissue, value, shading="gouraud")
        axes.triplot(at[:, 1], at[:, 0], solution.top[:, :3], color="k", linewidth=0.2)
        axes.triplot(*solution.node_um[:, 1::-1].T, solution.top[:, :3], color="0.7", linewidth=0.2)
        axes.set(title=f"{name} at activation {solution.activation[level]:.2f}", aspect="equal",
                 xlabel="col (um)", ylabel="row (um)")
        axes.invert_yaxis()
        figure.colorbar(shade, ax=axes)
    figure.savefig(path, dpi=80)


if __name__ == "__main__":
    main()
