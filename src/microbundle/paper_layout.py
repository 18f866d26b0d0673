"""Write a result in the text layout of the published tool, for scripts that read it.

Names, shapes and units follow MicroBundleCompute: positions are markers x frames in pixels of the image, one pair of
files for each beat; `info.txt` has a row [beat, first frame, end frame]; strain is tiles x frames with the tiles row by
row. Only whole beats are written. Source: the published tool's file layout.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from .analysis import Analysis
from .data import Floats
from .errors import CalibrationMissing
from .folder import write_whole
from .geometry import rescale, to_tissue
from .numbers import beat_signal
from .published import paper_frame, paper_width

KIND = "files in the paper's layout"


def export_paper(analysis: Analysis, folder: Path | str, *, overwrite: bool = False) -> Path:
    """Write a result as the published tool's text files into a new folder, and return it.

    `results/` gets beat, rotated, interpolated and strain files; `masks/tissue_mask.txt` the mask. Times use the known
    frame rate and lengths the known pixel size: raises CalibrationMissing without them, for `beat_info.txt` has no
    place to say that they are unknown. Raises OutputError where the folder cannot be written, or is not new or empty;
    `overwrite` replaces an older export, but nothing else.
    """
    fps, um_per_px = _frame_rate(analysis), analysis.um_per_px
    if fps is None or um_per_px is None:
        raise CalibrationMissing(f"{analysis.name}: the paper's layout gives Hz and um, and the "
                                 f"{'frame rate' if fps is None else 'pixel size'} is not known. Analyze the movie "
                                 "again with --fps and --um-per-px")

    def write(into: Path) -> None:
        (into / "masks").mkdir()
        np.savetxt(into / "masks" / "tissue_mask.txt", analysis.masks.tissue.astype(int), fmt="%i")
        results = into / "results"
        results.mkdir()
        _write_beats(analysis, results, fps, um_per_px)
        _write_strain(analysis, results)

    return write_whole(Path(folder), KIND, write, overwrite=overwrite)


def _write_beats(a: Analysis, results: Path, fps: float, um_per_px: float) -> None:
    beats = np.flatnonzero(a.beats.complete)
    center, direction, turned_points, width = _axes(a)
    usable = a.tracks.kept & np.isfinite(a.beats.relaxed_px).all(axis=1)
    info = np.array([[i, a.beats.start[b], a.beats.stop[b]] for i, b in enumerate(beats)]).reshape(-1, 3)
    np.savetxt(results / "info.txt", info, fmt="%i")
    np.savetxt(results / "tissue_info.txt", np.array([width]))
    np.savetxt(results / "rot_info.txt", np.stack([center, direction]))
    np.savetxt(results / "beat_info.txt", _beat_info(a, beats, fps, um_per_px))
    grid = a.grid.point_px
    inside = np.isfinite(a.grid.displacement_px).all(axis=(0, 2))
    for i, b in enumerate(beats):
        frames = slice(int(a.beats.start[b]), int(a.beats.stop[b]))
        position = a.tracks.position_px[frames][:, usable]
        _write_pair(results, f"beat{i}", position)
        turned = turned_points(position)
        _write_pair(results, f"rotated_beat{i}", turned)
        _write_pair(results, f"rotated_translated_beat{i}", rescale(turned, center, um_per_px))
        moved = a.grid.displacement_px[frames][:, inside]
        _write_pair(results, f"interpolation_beat{i}", grid[inside] + moved - moved[:1])


def _beat_info(a: Analysis, beats: np.ndarray, fps: float, um_per_px: float) -> Floats:
    """Rate in Hz and amplitude in um; with more than two beats the first and last are left out, as published."""
    used = beats[1:-1] if len(beats) > 2 else beats
    if len(used) == 0:
        return np.array([np.nan, np.nan])
    rate = fps / float(np.mean(a.beats.stop[used] - a.beats.start[used]))
    signal = beat_signal(a)
    return np.array([rate, float(np.mean(signal[a.beats.peak[used]])) * um_per_px])


def _write_strain(a: Analysis, results: Path) -> None:
    if a.strain is None:
        return
    s = a.strain
    center, direction, _, _ = _axes(a)
    turned = to_tissue(s.center_px, center, direction) if s.angle_deg else s.center_px
    for i, b in enumerate(np.flatnonzero(a.beats.complete)):
        frames = slice(int(a.beats.start[b]), int(a.beats.stop[b]))
        parts = {"row": turned[frames, :, 0], "col": turned[frames, :, 1]}
        parts |= {f"F{'rc'[j]}{'rc'[k]}": s.F[frames, :, j, k] for j in (0, 1) for k in (0, 1)}
        for name, values in parts.items():
            np.savetxt(results / f"strain__beat{i}_{name}.txt", values.T)
    info = [s.grid, s.side_px] + ([center, direction] if s.angle_deg else [])
    np.savetxt(results / "strain__sub_domain_info.txt", np.array(info, float))


def _axes(a: Analysis) -> tuple[Floats, Floats, Callable[[Floats], Floats], float]:
    """Centre, direction, the turn of points into the tissue's axes, and the width in px, as the method sees them."""
    if a.config.method == "paper":
        frame = paper_frame(a.masks.tissue)
        center, direction, width = frame.center, frame.direction, paper_width(frame)
        if not frame.turned:
            return center, direction, lambda points: points, width
    else:
        center, direction, width = a.masks.axis.center_px, a.masks.axis.direction, a.masks.axis.width_center_px
    return center, direction, lambda points: to_tissue(points, center, direction), width


def _write_pair(results: Path, name: str, points: Floats) -> None:
    """Write points (F, P, 2) as two files of points x frames."""
    np.savetxt(results / f"{name}_row.txt", points[..., 0].T)
    np.savetxt(results / f"{name}_col.txt", points[..., 1].T)


def _frame_rate(a: Analysis) -> float | None:
    return None if a.time_s is None else float(1 / np.median(np.diff(a.time_s)))
