"""Masks as a person sees and changes them: found or drawn, with the tissue's axis, the pillars and the sub-domains.

Everything is measured by the same functions as in an analysis. What cannot be found is told as a finding, so that a
person can go on by hand. Polygons are lists of (row, col) with the middle of a pixel at whole numbers.
"""

from __future__ import annotations

import base64
import hashlib
import re
from binascii import Error as NoBase64
from collections import OrderedDict
from dataclasses import dataclass, replace
from threading import Lock
from typing import Any

import cv2
import numpy as np

from ..config import Config, merge
from ..data import Bools, Finding, Floats, Masks, Movie, Pillars
from ..errors import CannotMeasure, MaskUnusable
from ..mask import find_masks
from ..pillar_masks import find_pillars
from ..report.traces import rounded
from ..tiles import divided_rectangle, place_tiles
from .answers import Refused
from .frames import Shown
from .results import told

KEPT = 64
TOLERANCE_PX = 1.0
"""By how much an outline may miss the mask's border."""
PNG = b"\x89PNG\r\n\x1a\n"
FORM = ("method", "frame", "min_stability")
NAME = re.compile(r"tissue|pillar_[1-9][0-9]?")
"""Names of masks."""
ADDRESS = "data:image/png;base64,"


@dataclass(frozen=True)
class Wanted:
    """What is asked for: settings, and what was drawn."""

    config: Config
    drawn: dict[str, Bools]
    addresses: dict[str, str]
    """The pictures that were drawn, as they came."""
    no_pillars: bool
    """All pillars were taken away by hand."""


class Found:
    """What was found of movies lately, so that a small change is measured at once."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._kept: OrderedDict[tuple[Any, ...], Any] = OrderedDict()

    def masks(self, shown: Shown, movie: Movie, config: Config) -> Masks:
        """Find the masks of a movie. Raises CannotMeasure and MaskUnusable."""
        key = (shown.key, config.mask.model_dump_json(), config.axis_deg, _hash(movie.supplied_masks.get("tissue")))
        return self._once(key, lambda: find_masks(movie, config.mask, axis_deg=config.axis_deg))  # type: ignore[no-any-return]

    def pillars(self, shown: Shown, movie: Movie, masks: Masks, config: Config) -> Pillars:
        """Find the pillars of a movie. Raises CannotMeasure and MaskUnusable."""
        drawn = tuple((name, _hash(mask)) for name, mask in sorted(movie.supplied_masks.items()) if name != "tissue")
        key = (shown.key, "pillars", config.pillars.masks, _hash(masks.tissue), masks.axis.angle_deg, drawn)
        return self._once(key, lambda: find_pillars(movie, masks, config.pillars))  # type: ignore[no-any-return]

    def _once(self, key: tuple[Any, ...], find: Any) -> Any:
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        found = find()
        with self._lock:
            self._kept[key] = found
            while len(self._kept) > KEPT:
                self._kept.popitem(last=False)
        return found


def wanted(shown: Shown, config: Config, asked: dict[str, Any]) -> Wanted:
    """Read what is asked for. Raises Refused for pictures that do not fit, ConfigError for wrong settings."""
    mask = {name: asked[name] for name in FORM if asked.get(name) is not None}
    above: dict[str, Any] = {"mask": mask, "strain": _of_kind(asked, "strain")}
    if asked.get("axis_deg") is not None:
        above["axis_deg"] = asked["axis_deg"]
    settings = merge(config.model_dump(exclude_unset=True), above)
    settings["strain"] = {name: value for name, value in settings["strain"].items() if value is not None}
    drawn = {}
    if asked.get("tissue_png") is not None:
        drawn["tissue"] = picture(asked["tissue_png"], shown.movie.shape)
    pillars = _of_kind(asked, "pillar_pngs")
    for name, drawing in pillars.items():
        if not NAME.fullmatch(name) or name == "tissue":
            raise Refused(400, "BadRequest", f"{name[:50]}: expected a pillar's name, such as pillar_1")
        drawn[name] = picture(drawing, shown.movie.shape)
    came = {name: pillars[name] if name in pillars else asked["tissue_png"] for name in drawn}
    return Wanted(Config.from_dict(settings, source="settings"), drawn, came,
                  asked.get("pillar_pngs") is not None and not pillars)


def measure(found: Found, shown: Shown, asked: Wanted) -> dict[str, Any]:
    """Find masks, pillars and sub-domains, or measure those that were drawn."""
    config, movie = asked.config, shown.movie
    supplied = dict(movie.supplied_masks)
    if any(name != "tissue" for name in asked.drawn) or asked.no_pillars:
        supplied = {name: mask for name, mask in supplied.items() if name == "tissue"}
    if "tissue" in asked.drawn:
        config = Config.from_dict(merge(config.model_dump(exclude_unset=True), {"mask": {"method": "auto"}}))
    movie = replace(movie, supplied_masks=supplied | asked.drawn)
    out: dict[str, Any] = {"method": config.mask.method, "tissue": [], "holes": [], "tissue_png": None, "pillars": [],
                           "stability": None, "axis": None, "tiles": [], "tile_labels": [], "extents_px": None}
    findings: list[Finding] = []
    try:
        masks = found.masks(shown, movie, config)
    except (CannotMeasure, MaskUnusable) as error:
        return out | _judged([_failure(error)])
    outer, holes = polygons(masks.tissue)
    axis = masks.axis
    out |= {"method": masks.method, "tissue": outer, "holes": holes,
            "tissue_png": asked.addresses.get("tissue") or address(masks.tissue), "stability": masks.stability,
            "axis": {"center": rounded(axis.center_px, 6), "direction": rounded(axis.direction, 8),
                     "angle_deg": axis.angle_deg, "length_px": axis.length_px, "width_px": axis.width_center_px}}
    findings += masks.findings
    try:
        if not asked.no_pillars:
            pillars = found.pillars(shown, movie, masks, config)
            findings += pillars.findings
            out["pillars"] = [
                {"name": f"pillar_{name}", "polygon": (polygons(mask)[0] or [[]])[0],
                 "png": asked.addresses.get(f"pillar_{name}") or address(mask), "source": source, "score": score}
                for name, mask, source, score in zip(pillars.names, pillars.masks, pillars.source, pillars.score,
                                                     strict=True)]
    except CannotMeasure as error:
        findings.append(Finding("no_pillars", "info", str(error)))
    except MaskUnusable as error:
        findings.append(_failure(error))
    try:
        out["extents_px"] = divided_rectangle(masks, config.strain)
        tiling = place_tiles(masks, config)
        out |= {"tiles": rounded(tiling.corner_px, 6), "tile_labels": list(tiling.labels), "grid": tiling.grid}
    except CannotMeasure as error:
        findings.append(Finding("no_strain", "fail", str(error)))
    return out | _judged(findings)


def _judged(findings: list[Finding]) -> dict[str, Any]:
    levels = {finding.level for finding in findings}
    verdict = "fail" if "fail" in levels else "review" if "review" in levels else "pass"
    return {"findings": [told(finding) for finding in findings], "verdict": verdict}


def _failure(error: Exception) -> Finding:
    return Finding(re.sub(r"(?<!^)(?=[A-Z])", "_", type(error).__name__).lower(), "fail", str(error))


def polygons(mask: Bools) -> tuple[list[Any], list[Any]]:
    """Trace the outer borders of a mask (R, C), the longest first, and those of its holes."""
    found, order = cv2.findContours(np.asarray(mask, np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    outer: list[Any] = []
    holes: list[Any] = []
    for i, border in sorted(enumerate(found), key=lambda one: -len(one[1])):
        points: Floats = np.asarray(cv2.approxPolyDP(border, TOLERANCE_PX, closed=True)[:, 0, ::-1], float)
        if len(points) >= 3:
            (outer if order[0, i, 3] < 0 else holes).append(points.astype(int).tolist())
    return outer, holes


def picture(text: Any, shape: tuple[int, int]) -> Bools:
    """Read a mask from the PNG of a drawing: what is bright, and not transparent, is in. Raises Refused."""
    try:
        if not isinstance(text, str):
            raise ValueError
        data = base64.b64decode(text.removeprefix(ADDRESS), validate=True)
        size = int.from_bytes(data[20:24], "big"), int.from_bytes(data[16:20], "big")
        if not data.startswith(PNG):
            raise ValueError
    except (ValueError, NoBase64):
        raise Refused(400, "BadRequest", "expected the mask as a PNG, in a data address") from None
    if size != tuple(shape):  # before it is unpacked: a small file can hold a huge picture
        raise Refused(422, "MaskUnusable", f"expected a mask of {shape[0]} x {shape[1]} px like the frames; found "
                      f"{size[0]} x {size[1]}")
    found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if found is None:
        raise Refused(400, "BadRequest", "expected the mask as a PNG; it cannot be unpacked")
    if found.dtype == np.uint16:
        found = (found // 256).astype(np.uint8)
    if found.ndim == 2:
        return np.asarray(found > 127)
    seen = found[..., :3].max(axis=2) > 127
    return np.asarray(seen & (found[..., 3] > 127)) if found.shape[2] == 4 else np.asarray(seen)


def png(mask: Bools) -> bytes:
    """Write a mask as PNG."""
    return cv2.imencode(".png", np.asarray(mask, np.uint8) * 255, [cv2.IMWRITE_PNG_BILEVEL, 1])[1].tobytes()


def address(mask: Bools) -> str:
    """Write a mask as the data address of a PNG."""
    return ADDRESS + base64.b64encode(png(mask)).decode()


def _of_kind(asked: dict[str, Any], name: str) -> dict[str, Any]:
    value = asked.get(name)
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise Refused(400, "BadRequest", f"{name}: expected an object")
    return value


def _hash(mask: Bools | None) -> str:
    return "" if mask is None else hashlib.sha256(np.packbits(mask).tobytes()).hexdigest()
