"""A piece of the level picture that could be a pillar, and where along the tissue pillars are."""

from __future__ import annotations

from dataclasses import dataclass

from .data import Floats

PLACE = (0.18, 0.26, 0.56, 0.66)
"""Distance of a pillar from the tissue's middle along the axis, as a share of the length; plausible from the second
number to the third, impossible before the first and after the last."""


@dataclass(frozen=True)
class Candidate:
    """A piece of the level picture that could be a pillar."""

    inside: Floats
    """(h, w): above zero on the pillar; its zero line is the outline."""
    center: Floats
    """(2,): its middle (row, col) from the tissue's middle, as shares of the tissue's length."""
    size: float
    """Square root of its area, as a share of the tissue's length."""
    kind: str
    """`bright cap`, `dark cap` or `plate`."""
    plausibility: float
    """0 to 1"""

    @property
    def end(self) -> int:
        """At which end of the tissue it lies: -1 where the axis starts, 1 where it ends."""
        return -1 if self.center[1] < 0 else 1
