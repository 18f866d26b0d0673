"""Find the time stamps and the pixel size that a TIFF carries in its OME or ImageJ metadata."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
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


def tiff_calibration(tiff: tifffile.TiffFile, count: int) -> Calibration:
    """Read the frame times (count,) in seconds and the pixel size in um from OME-XML or ImageJ metadata."""
    if tiff.is_ome and tiff.ome_metadata:
        return _from_ome(tiff.ome_metadata, count)
    if tiff.is_imagej and tiff.imagej_metadata:
        return _from_imagej(tiff, tiff.imagej_metadata, count)
    return Calibration()


def _from_ome(text: str, count: int) -> Calibration:
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError:
        return Calibration()
    pixels = next((e for e in root.iter() if e.tag.endswith("}Pixels") or e.tag == "Pixels"), None)
    if pixels is None:
        return Calibration()
    return _square(_ome_size(pixels, "X"), _ome_size(pixels, "Y"), Calibration(time_s=_ome_times(pixels, count)))


def _ome_size(pixels: ElementTree.Element, side: str) -> float | None:
    size = _number(pixels.get(f"PhysicalSize{side}"))
    scale = UM_PER.get((pixels.get(f"PhysicalSize{side}Unit") or "µm").strip())
    return size * scale if size and scale else None


def _square(um_x: float | None, um_y: float | None, found: Calibration) -> Calibration:
    """Take the pixel size where both sides agree or one is known; say so where they do not."""
    if um_x and um_y and abs(um_x - um_y) > 1e-3 * um_x:
        note = Finding("pixels_not_square", "review", f"the file says that a pixel is {um_y:.4g} um high and "
                       f"{um_x:.4g} um wide; one size for both is needed, so it is taken as unknown")
        return replace(found, findings=(note,))
    return replace(found, um_per_px=um_x or um_y)


def _ome_times(pixels: ElementTree.Element, count: int) -> Floats | None:
    """Per-frame times where every frame has one, else the time increment."""
    stamps: dict[int, float] = {}
    for plane in pixels.iter():
        if plane.tag.endswith("Plane") and plane.get("DeltaT") is not None:
            unit = S_PER.get((plane.get("DeltaTUnit") or "s").strip())
            value, index = _number(plane.get("DeltaT")), _number(plane.get("TheT"))
            if unit and value is not None and index is not None:
                stamps[int(index)] = value * unit
    if count > 1 and sorted(stamps) == list(range(count)):
        times = np.array([stamps[i] for i in range(count)])
        if (np.diff(times) > 0).all():
            return np.asarray(times - times[0])
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
    return _square(um[0], um[1], found)


def _number(text: Any) -> float | None:
    try:
        value = float(text)
    except (TypeError, ValueError):
        return None
    return value if np.isfinite(value) and value >= 0 else None
