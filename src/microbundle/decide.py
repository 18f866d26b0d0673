"""Write down a person's decisions on a movie, and copy the masks that they name beside them."""

from __future__ import annotations

import hashlib
import os
import re
import tempfile
from collections.abc import Iterable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from .data import Bools
from .decisions import SUFFIX, Decisions, read_decisions, sidecar_of, write_decisions
from .errors import ConfigError, MaskUnusable, OutputError

MASKS = (".png", ".tif", ".tiff", ".bmp", ".txt", ".csv", ".json")
LARGEST_MASK = 200_000_000
"""Bytes of a mask file that is copied."""


def decide(result: Path | str, *, drop_beats: Iterable[int] = (), mark_beats: Iterable[tuple[int, int, int]] = (),
           masks: Iterable[Path | str] = (), accept: bool | None = None, note: str | None = None,
           settings: Mapping[str, Any] | None = None, why: str = "", by: str = "",
           forget: Iterable[int] = ()) -> Decisions:
    """Add decisions to those that lie beside a folder of results, and return them all.

    `drop_beats` are frames of beats that do not count, `mark_beats` are (first frame, frame of the peak, first frame
    after it). A mask file is that of the tissue, unless its name holds pillar_1, pillar_2, ...; it is copied. `forget`
    takes back older decisions by their number, from 0. The result changes when the movie is measured again. Raises
    ConfigError for a wrong decision, MaskUnusable, OutputError.
    """
    known = read_decisions(result)
    wrong = [number for number in forget if not 0 <= number < len(known.listed)]
    if wrong:
        raise ConfigError(f"{sidecar_of(result)}: expected the number of a decision, 0 to {len(known.listed) - 1}, to "
                          f"forget; found {wrong[0]}")
    left = [one for number, one in enumerate(known.as_list()) if number not in set(forget)]
    common = {"why": why, "by": by, "at": now()}
    new: list[dict[str, Any]] = [{"kind": "drop_beat", "peak_frame": frame} for frame in drop_beats]
    new += [{"kind": "mark_beat", "start_frame": first, "peak_frame": peak, "stop_frame": stop}
            for first, peak, stop in mark_beats]
    new += [{"kind": "settings", "settings": dict(settings)}] if settings else []
    new += [{"kind": "verdict", "accept": accept}] if accept is not None else []
    new += [{"kind": "note", "text": note}] if note else []
    source = str(sidecar_of(result))
    Decisions.from_list([{**one, **common} for one in new], source=source)  # before anything is written
    new += [_copied(Path(mask).expanduser(), result) for mask in masks]
    decided = Decisions.from_list([*left, *({**one, **common} for one in new)], home=known.home, source=source)
    if new or left != known.as_list():
        write_decisions(result, decided)
    return read_decisions(result)


def keep_mask(result: Path | str, name: str, mask: Bools) -> str:
    """Write a mask (R, C) beside the decisions on a result, as PNG of 0 and 255; returns the file's name there.

    `name` is tissue, pillar_1, ... Raises MaskUnusable for an empty mask, OutputError.
    """
    import cv2

    if not np.asarray(mask).any():
        raise MaskUnusable(f"{name}: expected some pixels in the mask; it is empty")
    fine, packed = cv2.imencode(".png", np.asarray(mask, np.uint8) * 255)
    if not fine:
        raise OutputError(f"{sidecar_of(result)}: the mask {name} cannot be written as PNG")
    return _put(result, f"{name}.png", packed.tobytes())


def now() -> str:
    """The time of a decision, with the offset of the place where it is made."""
    return datetime.now().astimezone().isoformat(timespec="seconds")


def _copied(mask: Path, result: Path | str) -> dict[str, str]:
    """Copy a mask file beside the decisions; its kind follows from its name."""
    found = re.search(r"pillar_([1-9][0-9]?)(?!\d)", mask.stem.lower())
    name = f"pillar_{found[1]}" if found else "tissue"
    if mask.suffix.lower() not in MASKS:
        raise MaskUnusable(f"{mask}: expected a mask, a file {', '.join(MASKS)}; found {mask.suffix or 'no ending'}")
    try:
        if mask.stat().st_size > LARGEST_MASK:
            raise MaskUnusable(f"{mask}: expected a mask; it is larger than {LARGEST_MASK} bytes")
        content = mask.read_bytes()
    except OSError as error:
        raise MaskUnusable(f"{mask}: the mask cannot be read: {error.strerror or error}") from None
    return {"kind": "use_mask", "name": name, "file": _put(result, f"{name}{mask.suffix.lower()}", content)}


def _put(result: Path | str, ending: str, content: bytes) -> str:
    """Write a file beside the decisions on a result, whole or not at all, and return its name."""
    sidecar = sidecar_of(result)
    start, _, suffix = ending.rpartition(".")
    mark = hashlib.sha256(content).hexdigest()[:8]  # so that no older decision comes to name another mask
    file = sidecar.with_name(f"{sidecar.name.removesuffix(SUFFIX)}.{start}-{mark}.{suffix}")
    partial = None
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        handle, partial = tempfile.mkstemp(prefix=f".{file.name}.partial-", dir=file.parent)
        with open(handle, "wb") as stream:
            stream.write(content)
        Path(partial).chmod(0o644)
        os.replace(partial, file)
        partial = None
    except OSError as error:
        raise OutputError(f"{file}: the mask cannot be written: {error.strerror or error}") from None
    finally:
        if partial is not None:
            Path(partial).unlink(missing_ok=True)
    return file.name
