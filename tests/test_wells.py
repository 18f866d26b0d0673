"""Names and sizes of plates."""

from __future__ import annotations

import pytest

from microbundle.errors import ConfigError
from microbundle.wells import PLATES, place_of, plate_size, well_name


def test_names_of_wells_go_both_ways() -> None:
    assert [place_of(name) for name in ("A1", "b03", " H12 ", "AF48", "Z1", "AA1")] == [
        (0, 0), (1, 2), (7, 11), (31, 47), (25, 0), (26, 0)]
    for rows, columns in PLATES.values():
        places = [(r, c) for r in range(rows) for c in range(columns)]
        assert [place_of(well_name(place)) for place in places] == places


@pytest.mark.parametrize("name", ["", "1A", "A0", "A", "12", "AAA1", "A1000", "A-1", "A1b"])
def test_other_names_are_no_wells(name: str) -> None:
    assert place_of(name) is None


@pytest.mark.parametrize(("last", "size"), [("A1", (2, 3)), ("B3", (2, 3)), ("C1", (3, 4)), ("D6", (4, 6)),
                                            ("A7", (6, 8)), ("H12", (8, 12)), ("I1", (16, 24)), ("AF48", (32, 48)),
                                            ("AG1", (33, 1))])
def test_a_plate_is_the_smallest_usual_one_that_has_all_wells(last: str, size: tuple[int, int]) -> None:
    place = place_of(last)
    assert place is not None
    assert plate_size([place]) == size


def test_a_given_size_must_have_all_wells() -> None:
    assert plate_size([(0, 0)], 384) == (16, 24)
    with pytest.raises(ConfigError, match=r"plate of 96 wells \(to H12\); found I1"):
        plate_size([(8, 0)], 96)
    with pytest.raises(ConfigError, match="expected one of 6, 12, 24, 48, 96, 384, 1536; found 7"):
        plate_size([(0, 0)], 7)
