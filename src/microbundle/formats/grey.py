"""Bring a decoded picture to 2-D grey in the numbers the file holds, and refuse what is no picture.

Colour becomes its luminance (ITU-R BT.601).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..data import Image
from ..errors import MovieUnreadable

MOST_BYTES = 2**30
"""A single frame of more than this is taken for a damaged header."""


def grey(frame: Image, axes: str, file: Path, shape: tuple[int, ...] | None, index: int | None = None) -> Image:
    """Bring a decoded page to 2-D grey, and check it against the shape of the first one."""
    where = place(file, index)
    if "S" in axes and frame.ndim == len(axes):
        frame = np.moveaxis(frame, axes.index("S"), -1)
    if frame.ndim > 2:
        # Only colour may be the last of three axes: a picture of one row or column keeps it.
        keep = 3 if "S" in axes and frame.shape[-1] > 1 else 2
        outer = tuple(i for i in range(frame.ndim - keep) if frame.shape[i] == 1)
        frame = np.squeeze(frame, axis=outer) if frame.ndim - len(outer) == keep else np.squeeze(frame)
    if frame.ndim == 3 and frame.shape[-1] in (2, 3, 4):
        frame = luminance(frame)
    if frame.ndim != 2 or min(frame.shape) < 1:
        raise MovieUnreadable(f"{where}: expected one grey or colour frame; found an array of shape {frame.shape}")
    if shape is not None and frame.shape != shape:
        raise MovieUnreadable(f"{where}: expected {shape[0]} x {shape[1]} px as in the first frame; "
                              f"found {frame.shape[0]} x {frame.shape[1]}")
    if frame.dtype.kind not in "iuf":
        raise MovieUnreadable(f"{where}: expected grey values; found {frame.dtype}")
    if np.issubdtype(frame.dtype, np.floating) and not np.isfinite(frame).all():
        raise MovieUnreadable(f"{where}: expected numbers; found NaN or infinity in {int((~np.isfinite(frame)).sum())} "
                              "pixels")
    return frame.astype(frame.dtype.newbyteorder("="), copy=False)


def luminance(frame: Image) -> Image:
    """Turn RGB or RGBA (R, C, 3 or 4), or grey with opacity (R, C, 2), to grey of the same number type."""
    rgb = frame[..., :3]
    if frame.shape[-1] == 2 or ((rgb[..., 0] == rgb[..., 1]).all() and (rgb[..., 0] == rgb[..., 2]).all()):
        return np.ascontiguousarray(rgb[..., 0])
    weighted = np.asarray(rgb @ np.array([0.299, 0.587, 0.114]))  # ITU-R BT.601
    if np.issubdtype(frame.dtype, np.integer):
        weighted = np.rint(weighted)
    return weighted.astype(frame.dtype)


def check_size(file: Path, rows: int, cols: int, itemsize: int) -> None:
    """Refuse frames that are empty or too large, by the header alone. Raises MovieUnreadable."""
    if rows < 1 or cols < 1 or rows * cols * itemsize > MOST_BYTES:
        raise MovieUnreadable(f"{file}: expected frames of 1 pixel to {MOST_BYTES >> 20} MB; its header says "
                              f"{rows} x {cols} px of {itemsize} bytes. The file is damaged, or no movie")


def undecodable(file: Path, error: Exception, index: int | None = None) -> MovieUnreadable:
    """Make the error for a file or frame that the library of its format gives up on."""
    reason = " ".join(str(error).split())[:300] or type(error).__name__
    hint = '; this compression needs another package: pip install "microbundle[codecs]"' \
        if "imagecodecs" in str(error) else ""
    kind = "TIFF" if file.suffix.lower() in (".tif", ".tiff") else "file"
    return MovieUnreadable(f"{place(file, index)}: the {kind} cannot be decoded: {reason}{hint}")


def place(file: Path, index: int | None) -> str:
    """Name a file, or a frame of it, in a message."""
    return f"{file}" if index is None else f"{file}, frame {index}"
