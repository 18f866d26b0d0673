"""Cut and filter frames on their way from the file; nothing is written anywhere."""

from __future__ import annotations

import numpy as np

from .config import Reading
from .data import Bools, Floats, Frames, Image, Ints

UNSHARP_PX = 2.0
FLASH_MAD = 8.0
"""A flash stands out of the frames around it by this many median absolute deviations ..."""
FLASH_SHARE = 0.05
"""... and by this share of the brightness."""


class Prepared:
    """Frames that are cropped, filtered and picked from others when they are asked for."""

    def __init__(self, frames: Frames, keep: Ints, box: tuple[int, int, int, int], reading: Reading) -> None:
        self._frames, self._keep, self._box, self._reading = frames, keep, box, reading

    def __len__(self) -> int:
        return len(self._keep)

    def __getitem__(self, index: int) -> Image:
        r0, r1, c0, c1 = self._box
        frame = filtered(self._frames[int(self._keep[index])], self._reading)
        # A copy, so that a small part that is kept does not keep the whole frame in memory.
        return frame if frame.shape == (r1 - r0, c1 - c0) else frame[r0:r1, c0:c1].copy()


def filtered(frame: Image, reading: Reading) -> Image:
    """Apply the kernel, blur and sharpening of the settings to one frame; its number type is kept."""
    if reading.kernel is None and reading.smooth_px == 0 and reading.sharpen == 0:
        return frame
    from scipy import ndimage

    # Single precision holds 16 bits exactly, but not 32.
    out: Floats = frame.astype(np.float64 if frame.dtype.itemsize > 2 else np.float32)
    if reading.kernel is not None:
        out = ndimage.correlate(out, np.array(reading.kernel, out.dtype), mode="reflect")
    if reading.smooth_px > 0:
        out = ndimage.gaussian_filter(out, reading.smooth_px)
    if reading.sharpen > 0:
        out += reading.sharpen * (out - ndimage.gaussian_filter(out, UNSHARP_PX))
    if np.issubdtype(frame.dtype, np.integer):
        limits = np.iinfo(frame.dtype)
        out = np.clip(np.rint(out), limits.min, limits.max)
    return out.astype(frame.dtype)


def find_flashes(frames: Frames, keep: Ints) -> Ints:
    """Find the frames whose mean brightness jumps away from those around them."""
    return np.asarray(keep[stands_out(np.array([float(frames[int(t)].mean()) for t in keep]))])


def stands_out(brightness: Floats) -> Bools:
    """Tell which frames' mean brightness (n,) jumps away from the median of the nine frames around them."""
    from scipy.ndimage import median_filter

    away = np.abs(brightness - median_filter(brightness, 9, mode="nearest"))
    limit = max(FLASH_MAD * float(np.median(away)), FLASH_SHARE * float(np.median(np.abs(brightness))))
    return np.asarray(away > limit)
