"""Write a synthetic movie in the paper's layout, with its truth beside it.

    OUT/movie/frame_0000.tif ...    the frames
    OUT/masks/tissue_mask.txt       the tissue at rest; pillar_mask_1.txt, ... where the picture has pillars
    OUT/truth.npz                   point_px (N, 2), displacement_px and position_px (T, N, 2), F and E (T, N, 2, 2),
                                    activation (T,), deformation_px (T,), mask (R, C), time_s (T,), um_per_px, fps,
                                    domain_px (4, n, 2)
    OUT/truth.csv                   one row a frame: time, activation, mean absolute displacement, beat number, rest
    OUT/calibration.toml            frame rate and pixel size, for `microbundle analyze --config`

Displacement counts from the unloaded tissue; points, vectors and tensors are in the order (row, col).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..data import Floats
from ..folder import write_whole
from .cases import Case
from .render import SyntheticMovie
from .scenes import Elements, Sheet
from .truth import true_beats

SPACING_PX = 4.0


def write_simulation(case: Case, folder: Path | str, *, spacing_px: float = SPACING_PX, masks: bool = True) -> Path:
    """Draw a case and write its movie and truth into a new folder, whole or not at all; returns the folder.

    Without `masks` the tissue is not given away. Raises OutputError where the folder exists and is not empty, or
    cannot be written.
    """
    import tifffile

    synthetic = case.make()

    def write(into: Path) -> None:
        (into / "movie").mkdir()
        digits = max(4, len(str(synthetic.movie.count - 1)))
        for t in range(synthetic.movie.count):
            tifffile.imwrite(into / "movie" / f"frame_{t:0{digits}}.tif", synthetic.movie.frames[t])
        if masks:
            (into / "masks").mkdir()
            np.savetxt(into / "masks" / "tissue_mask.txt", synthetic.truth.mask.astype(int), fmt="%i")
            for k, pillar in enumerate(synthetic.pillars, start=1):
                np.savetxt(into / "masks" / f"pillar_mask_{k}.txt", pillar.astype(int), fmt="%i")
        _write_truth(case, synthetic, into, spacing_px)

    return write_whole(Path(folder), "simulation", write)


def _write_truth(case: Case, synthetic: SyntheticMovie, into: Path, spacing_px: float) -> None:
    truth = synthetic.truth
    count = truth.motion.count
    points = truth.points_px(spacing_px)
    u = np.stack([truth.displacement_px(points, t) for t in range(count)])
    F = np.stack([truth.F(points, t) for t in range(count)])
    E = 0.5 * (np.swapaxes(F, -1, -2) @ F - np.eye(2))
    beats = true_beats(truth)
    activation = activation_of(case)
    time_s = np.arange(count) / truth.fps
    np.savez_compressed(into / "truth.npz", point_px=points, displacement_px=u, position_px=points + u, F=F, E=E,
                        activation=activation, deformation_px=beats.deformation_px, mask=truth.mask, time_s=time_s,
                        fps=truth.fps, um_per_px=truth.um_per_px, domain_px=case.domain.points_px)
    beat = np.full(count, -1)
    for b in range(len(beats)):
        beat[beats.start[b]:beats.stop[b]] = b
    columns = [np.arange(count), time_s, activation, np.hypot(u[..., 0], u[..., 1]).mean(axis=1), beat, beats.resting]
    np.savetxt(into / "truth.csv", np.stack(columns, axis=1), delimiter=",", comments="",
               fmt=["%d", "%.7g", "%.7g", "%.7g", "%d", "%d"],
               header="frame,time_s,activation,mean_absolute_displacement_px,beat,resting")
    text = f"# {case.name}: what a microscope would know\nfps = {truth.fps!r}\num_per_px = {truth.um_per_px!r}\n"
    (into / "calibration.toml").write_text(text, encoding="utf-8")


def activation_of(case: Case) -> Floats:
    """Activation (T,) of a case's tissue, where the activation starts; zeros for a tissue that rests."""
    scene = case.scene
    if isinstance(scene, Elements | Sheet):
        return np.asarray(scene.activation)
    if scene.rhythm is None:
        return np.zeros(case.make().movie.count)
    return scene.rhythm.activation(np.arange(scene.rhythm.count, dtype=float))[0]
