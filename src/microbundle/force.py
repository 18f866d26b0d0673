"""Forces of the pillars, in uN, from their deflection and stiffness; stress, work and loops of the tissue.

A pillar is an elastic beam, clamped at its base: F = k d with k = 6 E I / (a^2 (3 L - a)), where E is Young's modulus,
L the pillar's height, a the height at which the tissue pulls, and I = w t^3 / 12 for a rectangle of width w and
thickness t (in the direction of bending) or pi D^4 / 64 for a circle; k may be given instead. The deflection d counts
from the relaxed state of the same beats as the tissue's, joined by straight lines from rest to rest, so that drift is
no force.

Times are in frames, so that speeds and areas are per frame until `metrics` puts units to them. Source: paper, "Pillar
force"; S. Timoshenko, Strength of Materials (a cantilever with a load at a).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from .analysis import Analysis
from .config import PillarParams
from .contraction import rest_path
from .data import Bools, Floats, TissueAxis
from .dictionary import Level
from .numbers import Shape, clock, duty, end_distance

KPA = 1e3
"""kPa in a uN/um2 (a MPa)."""
NJ = 1e-3
"""nJ in a uN um (a pJ)."""


def stiffness(params: PillarParams) -> float | None:
    """Compute the stiffness of a pillar in uN/um: as given, or of its geometry; None where either is incomplete."""
    if params.stiffness_un_per_um is not None:
        return params.stiffness_un_per_um
    modulus, length = params.modulus_mpa, params.length_um
    height = params.force_height_um or length
    if params.profile == "circle":
        inertia = None if params.diameter_um is None else np.pi * params.diameter_um**4 / 64
    else:
        both = params.width_um is not None and params.thickness_um is not None
        inertia = params.width_um * params.thickness_um**3 / 12 if both else None  # type: ignore[operator]
    if modulus is None or length is None or height is None or inertia is None:
        return None
    return float(6 * modulus * inertia / (height**2 * (3 * length - height)))


@dataclass(frozen=True)
class Forces:
    """What the pillars feel; T frames, P pillars, in px where no force is known."""

    deflection_px: Floats
    """(T, P, 2): from the relaxed state."""
    along_px: Floats
    """(T, P): deflection along the pillar's own motion, positive in contraction."""
    inward_px: Floats
    """(T, P): deflection along the axis from pillar to pillar, positive towards the other one."""
    rest_px: Floats
    """(T, P, 2): relaxed position, counted from the reference frame."""
    direction: Floats
    """(P, 2): unit vector of the pillar's own motion."""
    un_per_px: float
    """Force of a pixel; NaN where stiffness or pixel size is not known."""


def forces(analysis: Analysis) -> Forces | None:
    """Compute the pillars' deflections, and the force of a pixel; None for a result without pillars."""
    motion = analysis.pillars
    if motion is None:
        return None
    k, um = stiffness(analysis.config.pillars), analysis.um_per_px
    rest = rest_path(motion.shift_px, analysis.beats.relaxed, clock(analysis))
    # The published tool counts from the first frame.
    moved = motion.shift_px - (motion.shift_px[0] if motion.method == "markers" else rest)
    own = np.stack([_direction(moved[:, p], analysis.beats.relaxed) for p in range(moved.shape[1])])
    inward = _inward(motion.pillars.center_px, analysis.masks.axis)
    return Forces(moved, np.einsum("tpi,pi->tp", moved, own), np.einsum("tpi,pi->tp", moved, inward), rest, own,
                  np.nan if k is None or um is None else k * um)


def _direction(moved: Floats, relaxed: Bools) -> Floats:
    """Unit vector (2,) along which a pillar moves most, in the sense in which it moves while the tissue contracts."""
    seen = moved[np.isfinite(moved).all(axis=1)]
    if len(seen) == 0 or not seen.any():
        return np.array([0.0, 1.0])
    direction = np.linalg.svd(seen - seen.mean(axis=0), full_matrices=False)[2][0]
    busy = moved[~relaxed & np.isfinite(moved).all(axis=1)]
    return np.asarray(direction * (1.0 if len(busy) == 0 or busy.mean(axis=0) @ direction >= 0 else -1.0))


def _inward(centers: Floats, axis: TissueAxis) -> Floats:
    """Unit vector (P, 2) from each pillar's centre (P, 2) towards the other end: to the far pillar, or along the
    tissue's axis."""
    if len(centers) > 1:
        far = np.array([centers[np.argmax(((centers - c) ** 2).sum(axis=1))] for c in centers])
        way = far - centers
        return np.asarray(way / np.linalg.norm(way, axis=1, keepdims=True))
    side = np.sign((axis.center_px - centers) @ axis.direction)
    return np.asarray(np.where(side == 0, 1.0, side)[:, None] * axis.direction)


def pillar_values(analysis: Analysis, found: Forces, measured: Shape) -> dict[str, Floats]:
    """Compute the metrics of each pillar in each beat from the `forces` and the shape of `Forces.along_px`: name ->
    (B, P)."""
    motion = analysis.pillars
    if motion is None:
        return {}
    shape = measured | duty(measured, "pillar")
    scaled = ("amplitude", "contraction_velocity", "relaxation_velocity", "mean_contraction_velocity", "area")
    deflection = shape["force_amplitude"].copy()
    for name in scaled:
        shape[f"force_{name}"] = shape[f"force_{name}"] * found.un_per_px
    parts = [found.deflection_px, found.inward_px[..., None], motion.rotation_deg[..., None]]
    at_peak = np.concatenate(parts, axis=2)[analysis.beats.peak]
    path = found.rest_px[analysis.beats.peak]
    unloaded = analysis.config.pillars.unloaded_px
    rest = np.zeros(deflection.shape)
    if unloaded is not None:
        rest = np.einsum("bpi,pi->bp", motion.pillars.center_px + path - np.array(unloaded), found.direction)
    um = np.nan if analysis.um_per_px is None else analysis.um_per_px
    start = rest * um
    k = stiffness(analysis.config.pillars)
    work = NJ * 0.5 * (np.nan if k is None else k) * ((deflection * um + start) ** 2 - start**2)
    out = {
        "deflection": deflection, "deflection_row": at_peak[..., 0], "deflection_col": at_peak[..., 1],
        "deflection_axis": at_peak[..., 2], **shape,
        "force_absolute": np.hypot(at_peak[..., 0], at_peak[..., 1]) * found.un_per_px,
        "force_row": at_peak[..., 0] * found.un_per_px, "force_col": at_peak[..., 1] * found.un_per_px,
        "force_axis": at_peak[..., 2] * found.un_per_px, "rotation": at_peak[..., 3], "work": work,
        "power": work / shape["force_time_to_peak_from_onset"],
        "pillar_drift": np.linalg.norm(path - path[:1], axis=-1) if len(path) else np.zeros(deflection.shape),
    }
    if unloaded is not None:
        out["resting_force"] = rest * found.un_per_px
    return out


def pillar_series(analysis: Analysis) -> dict[str, Floats]:
    """Compute the metrics of each pillar in each frame: name -> (T, P)."""
    found, motion = forces(analysis), analysis.pillars
    if found is None or motion is None:
        return {}
    row, col = np.moveaxis(found.deflection_px, 2, 0)
    return {"pillar_deflection": np.hypot(row, col), "pillar_deflection_row": row, "pillar_deflection_col": col,
            "pillar_deflection_axis": found.inward_px, "pillar_force": found.along_px * found.un_per_px,
            "pillar_rotation": motion.rotation_deg}


def tissue_force_values(analysis: Analysis, found: Forces, pillars: Mapping[str, Floats]) -> dict[str, Floats]:
    """Compute the metrics of each beat that need the tissue, the `forces` and the `pillar_values`: name -> (B,)."""
    each = pillars["force_amplitude"]
    mean = each.mean(axis=1)
    out = {"twitch_force": mean}
    if each.shape[1] == 2:
        out["imbalance"] = (each[:, 0] - each[:, 1]) / (each[:, 0] + each[:, 1])
    params, um = analysis.config.pillars, analysis.um_per_px
    if params.depth_um is not None and um is not None:
        area = analysis.masks.axis.width_center_px * um * params.depth_um
        out |= {"stress_rectangle": KPA * mean / area, "stress_ellipse": KPA * mean / (np.pi / 4 * area)}
    force = found.along_px.mean(axis=1) * found.un_per_px
    if um is not None:
        distance, _ = end_distance(analysis)
        out["force_shortening_loop"] = NJ * um * loop_areas(analysis, -distance, force)
    if analysis.strain is not None:
        E_cc = analysis.strain.E[..., 1, 1]
        E_cc = E_cc[:, np.isfinite(E_cc).all(axis=0)]
        if E_cc.shape[1]:
            out["force_strain_loop"] = loop_areas(analysis, -E_cc.mean(axis=1), force)
    return out


def loop_areas(analysis: Analysis, x: Floats, y: Floats) -> Floats:
    """Area (B,) that the curve y over x encloses in each whole beat: the integral of y dx, the ends joined by a
    straight line. Positive where y is larger while x grows. Between frames both are cubic splines in time."""
    from scipy.interpolate import make_interp_spline

    beats, times = analysis.beats, clock(analysis)
    out = np.full(len(beats), np.nan)
    if len(times) < 4 or not (np.isfinite(x).all() and np.isfinite(y).all()):
        return out
    curve = make_interp_spline(times, np.stack([x, y], axis=1), k=3)
    for b in np.flatnonzero(beats.complete):
        first, last = int(beats.start[b]), min(int(beats.stop[b]), len(times) - 1)
        fine = curve(np.linspace(times[first], times[last], 16 * (last - first) + 1))
        u, v = np.append(fine, fine[:1], axis=0).T
        out[b] = float((0.5 * (v[1:] + v[:-1]) * np.diff(u)).sum())
    return out


def budget(analysis: Analysis, values: Mapping[Level, Mapping[str, Floats]],
           errors: Mapping[str, Floats]) -> Iterator[dict[str, object]]:
    """List what makes a force or stress uncertain, source by source: rows of quantity, source, error in percent.

    `values` are the numbers of all beats, `errors` the standard errors of their means by tracking. Sources whose size
    was not given are listed without a number, and are not part of the total.
    """
    motion, params, whole = analysis.pillars, analysis.config.pillars, analysis.beats.complete
    found = forces(analysis)
    if motion is None or found is None or not whole.any() or np.isnan(found.un_per_px):
        return
    given = {"stiffness": params.stiffness_error_pct, "pixel size": params.um_per_px_error_pct}
    quantities = [(f"force_amplitude of pillar {name}", values["pillar"]["force_amplitude"][whole, p],
                   errors.get("pillar.force_amplitude", np.full(len(motion.pillars), np.nan))[p], given)
                  for p, name in enumerate(motion.pillars.names)]
    quantities.append(("twitch_force", values["beat"]["twitch_force"][whole], errors.get("twitch_force", np.nan),
                       given))
    if "stress_ellipse" in values["beat"]:
        # The pixel size is in the force once and in the width once, so that it cancels in the stress.
        only = {"stiffness": params.stiffness_error_pct, "depth": params.depth_error_pct}
        quantities.append(("stress_ellipse", values["beat"]["stress_ellipse"][whole],
                           errors.get("stress_ellipse", np.nan), only))
    for quantity, each, tracking, told in quantities:
        each = each[np.isfinite(each)]
        if len(each) == 0:
            continue
        mean = float(each.mean())
        spread = float(each.std(ddof=1)) / np.sqrt(len(each)) if len(each) > 1 else np.nan
        parts = {"tracking": 100 * float(tracking) / abs(mean), "spread of the beats": 100 * spread / abs(mean),
                 **{source: np.nan if size is None else size for source, size in told.items()}}
        total = float(np.sqrt(np.nansum(np.square(list(parts.values())))))
        for source, size in {**parts, "total of what is known": total}.items():
            yield {"quantity": quantity, "source": source, "se_pct": size}
