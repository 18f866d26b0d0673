"""Find the time stamps and the pixel size that a TIFF carries in its OME, ImageJ or Micro-Manager metadata."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import tifffile

from .data import Finding, Floats, Source

UM_PER = {"nm": 1e-3, "um": 1.0, "µm": 1.0, "μm": 1.0, "micron": 1.0, "microns": 1.0, "micrometer": 1.0, "mm": 1e3,
          "cm": 1e4, "m": 1e6}
S_PER = {"ns": 1e-9, "µs": 1e-6, "μs": 1e-6, "us": 1e-6, "ms": 1e-3, "msec": 1e-3, "s": 1.0, "sec": 1.0,
         "seconds": 1.0, "min": 60.0, "h": 3600.0}


@dataclass(frozen=True)
class Calibration:
    """What a file says of time and scale; None where it says nothing."""

    time_s: Floats | None = None
    um_per_px: float | None = None
    findings: tuple[Finding, ...] = ()

    @property
    def time_source(self) -> Source:
        return "unknown" if self.time_s is None else "file"

    @property
    def um_per_px_source(self) -> Source:
        return "unknown" if self.um_per_px is None else "file"


def tiff_calibration(tiff: tifffile.TiffFile, count: int, series: int = 0, axis: str = "T",
                     fixed: Mapping[str, int] | None = None,
                     page: Callable[[int], Any] = lambda _: None) -> Calibration:
    """Read the frame times (count,) in seconds and the pixel size in um from OME, ImageJ or Micro-Manager metadata.

    The frames run along `axis` of a series, at the indices `fixed` on its other axes; `page` gives a frame's TIFF page.
    """
    if tiff.is_ome and tiff.ome_metadata:
        return _from_pages(_from_ome(tiff.ome_metadata, count, series, axis, fixed or {}), page, count)
    if tiff.is_imagej and tiff.imagej_metadata:
        return _from_imagej(tiff, tiff.imagej_metadata, count)
    return Calibration()


def rising(times_s: Floats | None) -> Floats | None:
    """Count times from the first; None for times that are not numbers or do not rise."""
    if times_s is None or not np.isfinite(times_s).all() or not (np.diff(times_s) > 0).all() or times_s.size < 2:
        return None
    return np.asarray(times_s - times_s[0])


def square(um_row: float | None, um_col: float | None, found: Calibration) -> Calibration:
    """Take the pixel size where both sides agree or one is known; say so where they do not."""
    if um_row and um_col and abs(um_col - um_row) > 1e-3 * um_col:
        note = Finding("pixels_not_square", "review", f"the file says that a pixel is {um_row:.4g} um high and "
                       f"{um_col:.4g} um wide; one size for both is needed, so it is taken as unknown")
        return replace(found, findings=(note,))
    return replace(found, um_per_px=um_col or um_row or None)


def _from_ome(text: str, count: int, series: int, axis: str, fixed: Mapping[str, int]) -> Calibration:
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError:
        return Calibration()
    images = [e for e in root.iter() if e.tag.endswith("}Pixels") or e.tag == "Pixels"]
    if series >= len(images):
        return Calibration()
    pixels = images[series]
    return square(_ome_size(pixels, "Y"), _ome_size(pixels, "X"),
                  Calibration(time_s=_ome_times(pixels, count, axis, fixed)))


def _from_pages(found: Calibration, page: Callable[[int], Any], count: int) -> Calibration:
    """Fill gaps from what Micro-Manager writes into each page."""
    if (found.um_per_px and found.time_s is not None) or not _micromanager_tag(page(0)):
        return found
    tags = [_micromanager_tag(page(t)) for t in range(count)]
    ms = [_number(tag.get("ElapsedTime-ms")) for tag in tags]
    um = found.um_per_px or _number(tags[0].get("PixelSizeUm")) or None
    times = found.time_s if found.time_s is not None or None in ms else rising(np.array(ms, float) / 1000)
    return replace(found, time_s=times, um_per_px=None if found.findings else um)


def _ome_size(pixels: ElementTree.Element, side: str) -> float | None:
    size = _number(pixels.get(f"PhysicalSize{side}"))
    scale = UM_PER.get((pixels.get(f"PhysicalSize{side}Unit") or "µm").strip())
    return size * scale if size and scale else None


def _micromanager_tag(page: Any) -> dict[str, Any]:
    tag = None if page is None else page.aspage().tags.get("MicroManagerMetadata")
    return tag.value if tag is not None and isinstance(tag.value, dict) else {}


def _ome_times(pixels: ElementTree.Element, count: int, axis: str, fixed: Mapping[str, int]) -> Floats | None:
    """Per-frame times where every frame has one, else the time increment."""
    stamps: dict[int, float] = {}
    for plane in pixels.iter():
        if plane.tag.endswith("Plane") and plane.get("DeltaT") is not None:
            at = {a: _number(plane.get(f"The{a}")) or 0 for a in "TCZ"}
            unit, value = S_PER.get((plane.get("DeltaTUnit") or "s").strip()), _number(plane.get("DeltaT"))
            if unit and value is not None and all(at[a] == i for a, i in fixed.items() if a in at and a != axis):
                stamps[int(at.get(axis, at["T"]))] = value * unit
    if count > 1 and sorted(stamps) == list(range(count)):
        times = rising(np.array([stamps[i] for i in range(count)]))
        if times is not None:
            return times
    step, unit = _number(pixels.get("TimeIncrement")), S_PER.get((pixels.get("TimeIncrementUnit") or "s").strip())
    if not (step and unit):
        return None
    return np.arange(count, dtype=float) * (step * unit)


def _from_imagej(tiff: tifffile.TiffFile, metadata: dict[str, Any], count: int) -> Calibration:
    """ImageJ's `fps` is the speed at which it plays the movie, and a size in cm or inch is that of a print."""
    step, unit = _number(metadata.get("finterval")), S_PER.get(str(metadata.get("tunit", "s")).strip())
    found = Calibration(time_s=np.arange(count) * (step * unit) if step and unit else None)
    name = str(metadata.get("unit", "")).replace("\\u00B5", "µ").strip()
    um_per = None if name == "cm" else UM_PER.get(name)
    if um_per is None:
        return found
    tags = [tiff.pages[0].tags.get(f"{a}Resolution") for a in "XY"]  # type: ignore[union-attr]
    um = [um_per * t.value[1] / t.value[0] if t is not None and t.value[0] > 0 else None for t in tags]
    return square(um[1], um[0], found)


def _number(text: Any) -> float | None:
    try:
        value = float(text)
    except (TypeError, ValueError):
        return None
    return value if np.isfinite(value) and value >= 0 else None
