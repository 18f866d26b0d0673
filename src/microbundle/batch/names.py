"""Read plate, well and the like from the names of movies."""

from __future__ import annotations

import re

from ..errors import ConfigError
from .manifest import SHORT

SHAPES = {"well": r"[A-Za-z]{1,2}[0-9]{1,3}", "day": r"[0-9]+(?:\.[0-9]+)?"}
"""What a part of a name looks like; any other part is whatever stands there."""


class Pattern:
    """A pattern for the names of movies, which yields columns."""

    def __init__(self, text: str) -> None:
        """Take a simple pattern such as `{plate}_{well}`, with `*` for anything, or one with named groups, such as
        `(?P<plate>P[0-9]+)`. It is held against the end of a movie's path without its suffix. Raises ConfigError."""
        self.text = text
        try:
            self._regex = re.compile(rf"(?:.*/)?(?:{text if '(?P<' in text else _translated(text)})")
        except re.error as error:
            raise ConfigError(f"--pattern {text}: expected a pattern such as {{plate}}_{{well}}, or a regular "
                              f"expression with named groups: {error}") from None
        self.columns = tuple(SHORT.get(name, name) for name in self._regex.groupindex)
        if not self.columns:
            raise ConfigError(f"--pattern {text}: expected named parts, such as {{plate}}_{{well}}; found none")

    def read(self, movie: str) -> dict[str, str]:
        """Find the columns in a movie's name; nothing where the pattern does not fit it."""
        found = self._regex.fullmatch(re.sub(r"(?:\.ome)?\.[A-Za-z][A-Za-z0-9]{1,4}$", "", movie))
        if found is None:
            return {}
        return {SHORT.get(name, name): value or "" for name, value in found.groupdict().items()}


def _translated(simple: str) -> str:
    """Turn a simple pattern into a regular expression."""
    out = []
    for part in re.split(r"(\{[^{}]*\}|\*)", simple):
        if part == "*":
            out.append("[^/]*")
        elif re.fullmatch(r"\{[^{}]*\}", part):
            out.append(f"(?P<{part[1:-1]}>{SHAPES.get(part[1:-1], '[^/]+?')})")
        elif "{" in part or "}" in part:
            raise re.error("a brace without its partner")
        else:
            out.append(re.escape(part))
    return "".join(out)
