"""Faults of a synthetic plate: what is done to a movie, and what must be reported of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from .faults import blurred, flashing, flickering, repeating
from .render import SyntheticMovie

Stack = NDArray[Any]
"""Frames (T, R, C) of a movie, 12 bits in uint16."""
TOP = 4095
MOTIONLESS = "motionless"


@dataclass(frozen=True)
class Told:
    """What must be reported of a movie."""

    state: Literal["done", "failed"] = "done"
    kind: str = ""
    """Name of the error, where it has no result."""
    verdicts: tuple[str, ...] = ()
    finding: str = ""
    """A finding that the result must have."""
    right: bool = False
    """Its amplitude and rate are as good as those of a movie without a fault."""


GOOD = Told(verdicts=("pass", "review"), right=True)
_UNREADABLE = Told("failed", "MovieUnreadable")


def _seen(finding: str, *verdicts: str, right: bool = False) -> Told:
    return Told("done", "", verdicts, finding, right)


FAULTS: dict[str, Told] = {
    MOTIONLESS: _seen("no_measurable_motion", "fail"),
    "truncated file": _UNREADABLE,
    "out of focus": _seen("blurred", "review", "fail"),
    "half-size mask": Told("failed", "MaskUnusable"),
    "flash": _seen("flash", "pass", "review", right=True),
    "one frame": Told("failed", "CannotMeasure"),
    "drifting stage": _seen("drift", "review", right=True),
    "empty file": _UNREADABLE,
    "no tissue": Told("failed", "NoTissue"),
    "repeated frames": _seen("repeated_frames", "review"),
    "wrong suffix": _UNREADABLE,
    "weak light": _seen("low_contrast", "review", "fail"),
    "missing file": _UNREADABLE,
    "flicker": _seen("flicker", "pass", "review", right=True),
    "saturated": _seen("saturated", "pass", "review"),
    "hot pixels": Told("done", "", ("pass", "review"), right=True),
}
"""Every fault, and what must be reported of it; a small plate has the first ones."""


def write_movie(folder: Path, name: str, synthetic: SyntheticMovie, fault: str | None) -> str:
    """Write a movie as a multi-page TIFF, spoilt where a fault is named, and return its path from the folder."""
    import tifffile

    file = folder / f"{name}.tif"
    frames = np.asarray(synthetic.movie.frames)
    if fault in SPOIL:
        frames = SPOIL[fault](synthetic, frames)
    if fault == "half-size mask":
        (folder / name / "movie").mkdir(parents=True)
        (folder / name / "masks").mkdir()
        file = folder / name / "movie" / f"{name}.tif"
        half = synthetic.truth.mask[::2, ::2].astype(int)
        np.savetxt(folder / name / "masks" / "tissue_mask.txt", half, fmt="%i")
    if fault == "missing file":
        return file.name
    if fault == "wrong suffix":
        rows = "\n".join(",".join(map(str, row)) for row in frames[0, :8].tolist())
        file.write_text(f"{rows}\n", encoding="utf-8")
    elif fault == "empty file":
        file.touch()
    else:
        tifffile.imwrite(file, frames, photometric="minisblack", metadata=None)
    if fault == "truncated file":
        content = file.read_bytes()
        file.write_bytes(content[:len(content) // 3])
    return name if fault == "half-size mask" else file.name


def _array(movie: Any) -> Stack:
    return np.stack([movie.frames[t] for t in range(len(movie.frames))])


def _ground(_: SyntheticMovie, frames: Stack) -> Stack:
    """Take the tissue out of the picture: even ground with the camera's noise."""
    rng = np.random.default_rng(np.random.SeedSequence([int(frames[0].sum()), 63]))
    grain = ndimage.gaussian_filter(rng.standard_normal(frames[0].shape), 1.5)
    return np.asarray(np.rint(0.8 * TOP + 60 * grain + 20 * rng.standard_normal(frames.shape)).astype(frames.dtype))


def _drifting(_: SyntheticMovie, frames: Stack) -> Stack:
    """Let the stage drift by a thirtieth of a pixel a frame along the columns, and half of that along the rows."""
    shifted = [ndimage.shift(frame.astype(float), (t / 60, t / 30), order=3, mode="nearest")
               for t, frame in enumerate(frames)]
    return np.asarray(np.rint(np.clip(shifted, 0, TOP)).astype(frames.dtype))


def _weak(_: SyntheticMovie, frames: Stack) -> Stack:
    """Let hardly any light through: a hundredth of it, and the camera's own noise."""
    rng = np.random.default_rng(np.random.SeedSequence([int(frames[0].sum()), 64]))
    dark = 100 + frames * 0.01 + 3 * rng.standard_normal(frames.shape)
    return np.asarray(np.rint(np.clip(dark, 0, TOP)).astype(frames.dtype))


def _overexposed(made: SyntheticMovie, frames: Stack) -> Stack:
    """Open the shutter for too long: a fifth of the tissue is white."""
    level = np.quantile(frames[0][made.truth.mask], 0.8)
    return np.asarray(np.minimum(frames * (TOP / level), TOP).astype(frames.dtype))


def _hot(_: SyntheticMovie, frames: Stack) -> Stack:
    """Give the camera pixels that are always white, one in a thousand."""
    rng = np.random.default_rng(np.random.SeedSequence([int(frames[0].sum()), 65]))
    out = frames.copy()
    out[:, rng.random(frames.shape[1:]) < 0.001] = TOP
    return out


SPOIL: dict[str | None, Callable[[SyntheticMovie, Stack], Stack]] = {
    "out of focus": lambda made, _: _array(blurred(made.movie, 2.5)),
    "flash": lambda made, _: _array(flashing(made.movie, (11, 40), 0.25)),
    "one frame": lambda _, frames: frames[:1],
    "drifting stage": _drifting,
    "no tissue": _ground,
    "repeated frames": lambda made, _: _array(repeating(made.movie, range(5, len(made.movie.frames), 6))),
    "weak light": _weak,
    "flicker": lambda made, _: _array(flickering(made.movie, 0.03, 7)),
    "saturated": _overexposed,
    "hot pixels": _hot,
}
"""What is done to the frames, where anything is."""
