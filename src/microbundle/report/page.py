"""Put a page together: text that is escaped, data that cannot end its own script, and a policy that runs nothing else.

A page is a template with `{{name}}` in it. Everything that is put in is escaped, but for `Html`, which this package
writes itself. Styles and scripts stand in the page; their hashes are its Content-Security-Policy, so that a browser
runs no other script, and fetches nothing.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import math
import re
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.resources import files
from typing import Any

MISSING = "–"
MARK = '<meta name="generator" content="microbundle'
"""Text near the start of every page, by which one that we wrote is known."""


class Html(str):
    """Text that is HTML already."""

    __slots__ = ()


def escape(value: object) -> Html:
    """Write any value as text of a page; `Html` stays as it is."""
    return value if isinstance(value, Html) else Html(html.escape(str(value)))


def tag(name: str, content: object = "", /, **attributes: object) -> Html:
    """Write an element; `class_` and `data_x` become `class` and `data-x`, None and False leave an attribute out."""
    written = []
    for key, value in attributes.items():
        if value is None or value is False:
            continue
        plain = key.rstrip("_").replace("_", "-")
        written.append(f" {plain}" if value is True else f' {plain}="{html.escape(str(value))}"')
    return Html(f"<{name}{''.join(written)}>{escape(content)}</{name}>")


def joined(parts: Iterable[object], between: str = "") -> Html:
    """Join pieces of a page, each escaped where it has to be."""
    return Html(between.join(escape(part) for part in parts))


@cache
def asset(name: str) -> str:
    """Read a template, style or script of this package."""
    return (files(__package__) / "assets" / name).read_text(encoding="utf-8")


def fill(template: str, values: Mapping[str, object]) -> str:
    """Put values into a template; what is put in is not looked at again. Raises KeyError for a name without a value."""
    return re.sub(r"\{\{(\w+)\}\}", lambda found: str(escape(values[found[1]])), template)


def make_page(template: str, styles: Iterable[str], scripts: Iterable[str], data: Mapping[str, Any],
              values: Mapping[str, object]) -> str:
    """Make a page of a template and its styles and scripts (names of assets), with `data` as JSON in it."""
    style = "\n".join(asset(name) for name in styles)
    script = "\n".join(asset(name) for name in scripts)
    policy = (f"default-src 'none'; img-src data:; media-src data:; script-src {_hash(script)}; "
              f"style-src {_hash(style)}; base-uri 'none'; form-action 'none'")
    return fill(asset(template), {"policy": policy, "style": Html(style), "script": Html(script),
                                  "data": embedded(data), **values})


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def embedded(data: Mapping[str, Any]) -> Html:
    """Write JSON that is safe within a script element, whatever the names in it are."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"), ensure_ascii=False)
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Html(text)


def data_of(page: str) -> dict[str, Any]:
    """Take the data out of a page that `make_page` made. Raises ValueError where there are none."""
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    data = json.loads(found[1]) if found else None
    if not isinstance(data, dict):
        raise ValueError("expected a page with data in it")
    return data


def number(value: float | None, digits: int = 4) -> str:
    """Write a number for people, with a real minus sign; what is not known is a dash."""
    if value is None or not math.isfinite(value):
        return MISSING
    if value == 0:
        return "0"
    if not 1e-4 <= abs(value) < 1e6:
        text = f"{value:.{digits - 1}e}"
        mantissa, exponent = text.split("e")
        text = f"{mantissa}e{int(exponent)}"
    else:
        places = max(0, digits - 1 - math.floor(math.log10(abs(value))))
        text = f"{value:.{places}f}"
    return text.replace("-", "−")


def with_error(value: float | None, error: float | None) -> str:
    """Write a value with its standard error, to two digits of the error."""
    if value is None or error is None or not (math.isfinite(value) and math.isfinite(error)) or error <= 0:
        return number(value)
    places = max(0, 1 - math.floor(math.log10(error)))
    if places > 7:
        return f"{number(value)} ± {number(error, 2)}"
    return f"{value:.{places}f} ± {error:.{places}f}".replace("-", "−")
