"""Read masks that a person or another program made: text, pictures and polygons."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from .data import Bools, Finding, Floats, Movie
from .decisions import Decisions
from .errors import MaskUnusable

PICTURES = (".png", ".tif", ".tiff", ".bmp")


def read_mask(path: Path | str, shape: tuple[int, ...]) -> Bools:
    """Read a mask (R, C) from a file: text of 0/1 or 0/255, a two-valued picture, or a polygon.

    A polygon is a CSV file with the columns `row,col`, or a JSON list of [row, col] points, in pixels.
    `shape` is that of the movie's frames. Raises MaskUnusable for a missing file, other values, another shape, or an
    empty mask.
    """
    path = Path(path).expanduser()
    suffix = path.suffix.lower()
    try:
        if suffix in PICTURES:
            mask = _two_valued(_picture(path), path)
        elif suffix == ".json":
            mask = polygon_mask(_points(json.loads(path.read_text(encoding="utf-8"))), shape)
        elif suffix == ".csv":
            mask = polygon_mask(_points(np.genfromtxt(_lines(path), delimiter=",", names=True)), shape)
        else:
            mask = _two_valued(np.loadtxt(_lines(path), ndmin=2), path)
    except MaskUnusable as error:
        message = str(error)
        raise MaskUnusable(message if message.startswith(f"{path}") else f"{path}: {message}") from None
    except OSError as error:
        raise MaskUnusable(f"{path}: the mask cannot be read: {error.strerror or error}") from None
    except Exception as error:  # whatever a damaged file makes a parser raise
        raise MaskUnusable(f"{path}: expected a mask as text (0/1), picture, or polygon with columns row,col: "
                           f"{error}") from None
    if mask.shape != tuple(shape):
        raise MaskUnusable(f"{path}: expected a mask of {shape[0]} x {shape[1]} px like the frames; "
                           f"found {mask.shape[0]} x {mask.shape[1]}")
    if not mask.any():
        raise MaskUnusable(f"{path}: expected some pixels in the mask; it is empty")
    return mask


def find_supplied_masks(movie_path: Path, shape: tuple[int, ...],
                        tissue_mask: Path | str | None = None) -> dict[str, Bools]:
    """Read the masks that lie beside a movie in the paper's layout: `masks/tissue_mask.txt`, `pillar_mask_1.txt`, ...

    Returns them by the names `tissue`, `pillar_1`, `pillar_2`, ...; gaps in the numbers are allowed. The file
    `tissue_mask` is read instead of the folder's. Raises MaskUnusable.
    """
    found: dict[str, Bools] = {}
    if tissue_mask is not None:
        found["tissue"] = read_mask(tissue_mask, shape)
    folder = (movie_path.parent if movie_path.name == "movie" else movie_path) / "masks"
    if movie_path.is_file() or not folder.is_dir():
        return found
    try:
        files = sorted(folder.iterdir())
    except OSError as error:
        raise MaskUnusable(f"{folder}: the folder cannot be read: {error.strerror or error}") from None
    for file in files:
        name = file.name.lower()
        if name == "tissue_mask.txt" and tissue_mask is None:
            found["tissue"] = read_mask(file, shape)
        elif match := re.fullmatch(r"pillar_mask_(\d+)\.txt", name):
            found[f"pillar_{int(match[1])}"] = read_mask(file, shape)
    return found


def with_decided_masks(movie: Movie, decisions: Decisions) -> Movie:
    """Give a movie the masks that a person decided on, in place of those that came with it; findings say so.

    Raises MaskUnusable where a mask cannot be read, or does not fit the movie.
    """
    from_person = {name: read_mask(file, movie.shape) for name, file in decisions.masks.items()}
    if not from_person:
        return movie
    told = tuple(Finding("mask_decided", "info", f"by a person's decision the mask of the {name.replace('_', ' ')} is "
                         f"{decisions.masks[name].name}") for name in from_person)
    kept = movie.supplied_masks
    if any(name.startswith("pillar_") for name in from_person):
        kept = {name: mask for name, mask in kept.items() if not name.startswith("pillar_")}
    return replace(movie, supplied_masks={**kept, **from_person}, findings=(*movie.findings, *told))


def polygon_mask(points_px: Floats, shape: tuple[int, ...]) -> Bools:
    """Fill a polygon given by its corners (row, col) in pixels, shape (P, 2), with P at least 3; its edge is inside.

    Parts outside the frame are cut off. Raises MaskUnusable.
    """
    import cv2

    if points_px.ndim != 2 or points_px.shape[1] != 2 or len(points_px) < 3:
        raise MaskUnusable(f"polygon: expected at least three (row, col) points; found shape {points_px.shape}")
    if not np.isfinite(points_px).all():
        raise MaskUnusable("polygon: expected numbers; found an empty or unreadable coordinate")
    if np.abs(points_px).max() > 1e6:
        raise MaskUnusable("polygon: expected coordinates in pixels; found one beyond 1,000,000")
    canvas = np.zeros(shape, np.uint8)
    corners = np.rint(points_px[:, ::-1] * 16).astype(np.int32)
    cv2.fillPoly(canvas, [corners], 1, shift=4)
    return canvas > 0


def _points(raw: Any) -> Floats:
    if isinstance(raw, np.ndarray) and raw.dtype.names:
        names = {n.lower(): n for n in raw.dtype.names}
        if not {"row", "col"} <= names.keys():
            raise MaskUnusable(f"polygon: expected the columns row and col; found {', '.join(raw.dtype.names)}")
        return np.stack([np.atleast_1d(raw[names["row"]]), np.atleast_1d(raw[names["col"]])], axis=1)
    return np.asarray(raw, dtype=float)


def _lines(path: Path) -> list[str]:
    text = path.read_text(encoding="utf-8-sig")
    if not text.strip():
        raise ValueError("the file is empty")
    return text.splitlines()


def _picture(path: Path) -> Any:
    if path.suffix.lower() in (".tif", ".tiff"):
        import tifffile

        return tifffile.imread(path)
    import cv2

    packed = np.frombuffer(path.read_bytes(), np.uint8)
    picture = cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH) if packed.size else None
    if picture is None:
        raise ValueError("the picture cannot be decoded")
    return picture


def _two_valued(values: Any, path: Path) -> Bools:
    values = np.squeeze(values)
    if values.ndim == 3 and values.shape[-1] in (3, 4):
        values = values[..., 0]
    if values.ndim != 2:
        raise MaskUnusable(f"{path}: expected a 2-D mask; found shape {values.shape}")
    levels = np.unique(values)
    marks = levels[levels != 0]
    if len(marks) > 1 or not np.isin(marks, (1, 255, 65535)).all():
        shown = ", ".join(f"{v:g}" for v in levels[:5]) + (", ..." if len(levels) > 5 else "")
        raise MaskUnusable(f"{path}: expected a mask of 0 and 1, or 0 and 255; found the values {shown}")
    return np.asarray(values > 0)
