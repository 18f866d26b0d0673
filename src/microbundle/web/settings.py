"""The settings of an analysis as a form needs them: from the same texts, limits and choices as the command line's."""

from __future__ import annotations

from functools import cache
from typing import Any

from ..config import Config

FIRST = "Calibration and method"
UNITS = (("_um_per_px", "µm/px"), ("_un_per_um", "µN/µm"), ("_px", "px"), ("_um", "µm"), ("_mpa", "MPa"), ("_s", "s"),
         ("_hz", "Hz"), ("_deg", "°"), ("_pct", "%"))
LIMITS = {"minimum": "minimum", "maximum": "maximum", "exclusiveMinimum": "above", "exclusiveMaximum": "below",
          "multipleOf": "step"}
WORDS = {"fps": "Frames per second", "um_per_px": "Pixel size", "axis_deg": "Angle of the tissue"}
TITLES = {"reading": "Reading", "mask": "Tissue mask", "pillars": "Pillars", "markers": "Markers",
          "tracking": "Tracking", "registration": "Registration", "beats": "Beats", "grid": "Grid", "strain": "Strain",
          "metrics": "Metrics"}


@cache
def sections() -> list[dict[str, Any]]:
    """All settings, section by section."""
    schema = Config.model_json_schema()
    known = schema["$defs"]
    top, out = [], []
    for key, one in schema["properties"].items():
        inside = known.get(str(one.get("$ref", "")).rpartition("/")[2])
        if inside is None:
            top.append(_field(key, one))
            continue
        fields = [_field(f"{key}.{name}", part) for name, part in inside["properties"].items()]
        text = " ".join((one.get("description") or inside.get("description", "")).split())
        out.append({"section": key, "title": TITLES.get(key, key), "text": text, "fields": fields})
    text = "What the file does not know, and how it is measured."
    return [{"section": "", "title": FIRST, "text": text, "fields": top}, *out]


def _field(key: str, one: dict[str, Any]) -> dict[str, Any]:
    parts = one.get("anyOf", [one])
    main = next(part for part in parts if part.get("type") != "null")
    name = key.rpartition(".")[2]
    out = {"key": key, "label": WORDS.get(name, _label(name)), "text": " ".join(one.get("description", "").split()),
           "type": _type(main), "optional": len(parts) > 1, "choices": main.get("enum"),
           "default": one.get("default"), "unit": "frames/s" if name == "fps" else _unit(name)}
    out |= {told: main[limit] for limit, told in LIMITS.items() if limit in main}
    if main.get("type") == "array":
        items = main.get("prefixItems") or [main.get("items", {})]
        out |= {"length": main.get("maxItems"), "items": _type(items[0]) if items else "number"}
    return out


def _type(one: dict[str, Any]) -> str:
    if "enum" in one:
        return "choice"
    kind = str(one.get("type", "object"))
    nested = kind == "array" and (one.get("items") or {}).get("type") == "array"
    return {"array": "rows" if nested else "list"}.get(kind, kind)


def _label(name: str) -> str:
    for ending, _ in UNITS:
        if name.endswith(ending):
            name = name.removesuffix(ending)
            break
    text = name.replace("_", " ")
    return text[:1].upper() + text[1:]


def _unit(name: str) -> str:
    return next((unit for ending, unit in UNITS if f"_{name}".endswith(ending)), "")
