"""Multi-well plates: their usual sizes, and where a well stands by its name.

Rows are letters (A to Z, then AA to AF), columns are numbers from 1, as on the plates themselves: B3 is the third well
of the second row, and B03 the same.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from .errors import ConfigError

PLATES = {6: (2, 3), 12: (3, 4), 24: (4, 6), 48: (6, 8), 96: (8, 12), 384: (16, 24), 1536: (32, 48)}
"""Wells of a plate, and its rows and columns."""
Place = tuple[int, int]
"""Row and column of a well, counted from 0."""


def place_of(well: str) -> Place | None:
    """Read row and column, counted from 0, from the name of a well such as B3; None where it is not such a name."""
    found = re.fullmatch(r"\s*([A-Za-z]{1,2})0*([1-9][0-9]{0,2})\s*", well)
    if found is None:
        return None
    row = 0
    for letter in found[1].upper():
        row = 26 * row + ord(letter) - ord("A") + 1
    return row - 1, int(found[2]) - 1


def row_name(row: int) -> str:
    """Name a row, counted from 0, by its letters."""
    above, last = divmod(row, 26)
    return (row_name(above - 1) if above else "") + chr(ord("A") + last)


def well_name(place: Place) -> str:
    """Name a well, such as B3."""
    return f"{row_name(place[0])}{place[1] + 1}"


def plate_size(places: Iterable[Place], wells: int | None = None) -> Place:
    """Find rows and columns of the smallest usual plate that has these places; of `wells` wells where that is given.

    Beyond the largest usual plate the size is that of the places themselves. Raises ConfigError for an unusual number
    of wells, or places that such a plate does not have.
    """
    listed = list(places)
    rows, columns = (max((place[side] for place in listed), default=0) + 1 for side in (0, 1))
    if wells is not None:
        if wells not in PLATES:
            raise ConfigError(f"wells: expected one of {', '.join(map(str, PLATES))}; found {wells}")
        if rows > PLATES[wells][0] or columns > PLATES[wells][1]:
            raise ConfigError(f"wells: expected places of a plate of {wells} wells (to {_last(PLATES[wells])}); found "
                              f"{well_name((rows - 1, columns - 1))}")
        return PLATES[wells]
    return next((size for size in PLATES.values() if size[0] >= rows and size[1] >= columns), (rows, columns))


def _last(size: Place) -> str:
    return well_name((size[0] - 1, size[1] - 1))
