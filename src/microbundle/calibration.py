"""Find the time stamps and the pixel size that a TIFF carries in its OME or ImageJ metadata."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from typing import Any

import numpy as np
import tifffile

from .data import Floats, Source

UM_PER = {"nm": 1e-3, "um": 1.0, "µm": 1.0, "μm": 1.0, "micron": 1.0, "microns": 1.0, "micrometer": 1.0, "mm": 1e3,
          "cm": 1e4, "m": 1e6}
S_PER = {"ns": 1e-9, "µs": 1e-6, "μs": 1e-6, "us": 1e-6, "ms": 1e-3, "msec": 1e-3, "s": 1.0, "sec": 1.0,
         "seconds": 1.0, "min": 60.0, "h": 3600.0}


@dataclass(frozen=True)
class Calibration:
    """What a file says of time and scale; None where it says nothing."""

    time_s: Floats | None = None
    um_per_px: float | None = None

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
    sizes = [_number(pixels.get(f"PhysicalSize{a}")) for a in "XY"]
    scales = [UM_PER.get((pixels.get(f"PhysicalSize{a}Unit") or "µm").strip()) for a in "XY"]
    um = [n * s for n, s in zip(sizes, scales, strict=True) if n and s]
    square = len(um) == 2 and abs(um[0] - um[1]) < 1e-3 * um[0]
    return Calibration(time_s=_ome_times(pixels, count), um_per_px=um[0] if square or len(um) == 1 else None)


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
            return times - times[0]
    step, unit = _number(pixels.get("TimeIncrement")), S_PER.get((pixels.get("TimeIncrementUnit") or "s").strip())
    return np.arange(count) * step * unit if step and unit else None


def _from_imagej(tiff: tifffile.TiffFile, metadata: dict[str, Any], count: int) -> Calibration:
    step = _number(metadata.get("finterval"))
    if not step and (fps := _number(metadata.get("fps"))):
        step = 1.0 / fps
    unit = S_PER.get(str(metadata.get("tunit", "s")).strip(), 1.0)
    um_per = UM_PER.get(str(metadata.get("unit", "")).replace("\\u00B5", "µ").strip())
    um = None
    tag = tiff.pages[0].tags.get("XResolution")  # type: ignore[union-attr]
    if um_per and tag is not None and tag.value[0] > 0:
        um = um_per * tag.value[1] / tag.value[0]
    return Calibration(time_s=np.arange(count) * step * unit if step else None, um_per_px=um)


def _number(text: Any) -> float | None:
    try:
        value = float(text)
    except (TypeError, ValueError):
        return None
    return value if np.isfinite(value) and value >= 0 else None
