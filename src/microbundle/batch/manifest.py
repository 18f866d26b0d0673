"""What is known of each movie beside its frames: the columns of a manifest, or the parts of a name, checked.

Columns that are settings (`fps`, `um_per_px`, `stiffness`, `depth`, `pacing`) hold for that movie alone, and win over
the settings of the run. All others are kept as text and come back in the tables.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import ConfigError

MOVIE = "movie"
PLACES = ("group", "plate", "well", "day")
"""Columns that come first in the tables."""
SETTINGS = {"fps": ("fps",), "um_per_px": ("um_per_px",), "stiffness_un_per_um": ("pillars", "stiffness_un_per_um"),
            "depth_um": ("pillars", "depth_um"), "pacing_hz": ("metrics", "pacing_hz")}
"""Columns that are settings, and where in the settings."""
SHORT = {"stiffness": "stiffness_un_per_um", "depth": "depth_um", "pacing": "pacing_hz"}
"""Short names of columns, and the names with units that the tables have."""
TAKEN = {"metric", "n", "mean", "se", "sd", "low_95", "high_95", "verdict", "state", "failure_kind", "failure", "beats",
         "result"}
"""Columns of the tables that are written; no column of a manifest may have such a name."""
SHOWN_ERRORS = 10


def read_manifest(file: Path) -> list[tuple[str, Path, dict[str, str]]]:
    """Read a manifest: for each row the movie's name as it stands there, its path, and its other columns.

    A CSV file in UTF-8 with a header; separated by commas, semicolons or tabs. Paths count from the manifest's folder.
    Raises ConfigError that names each wrong row (as a spreadsheet counts them, the header being row 1) and column.
    """
    try:
        text = file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file}: expected a manifest, a CSV file in UTF-8: {error}") from None
    head = text.split("\n", 1)[0]
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=max(",;\t", key=head.count), strict=True)
    try:
        rows = list(enumerate(reader, 1))
    except csv.Error as error:
        raise ConfigError(f"{file}, row {reader.line_num}: expected cells in CSV: {error}") from None
    header = _header(file, rows[0][1] if rows else [])
    out, wrong, seen = [], [], dict[Path, int]()
    for number, cells in rows[1:]:
        if not any(cell.strip() for cell in cells):
            continue
        if len(cells) > len(header):
            wrong.append(f"{file}, row {number}: expected at most {len(header)} cells, as in the header; "
                         f"found {len(cells)}")
            continue
        row = dict(zip(header, (cell.strip() for cell in cells), strict=False))
        movie = row.pop(MOVIE, "").replace("\\", "/").rstrip("/")
        path = file.parent / Path(movie).expanduser()
        if not movie:
            wrong.append(f"{file}, row {number}, column {MOVIE}: expected the path of a movie; the cell is empty")
        elif path in seen:
            wrong.append(f"{file}, row {number}, column {MOVIE}: expected each movie once; {movie} is in row "
                         f"{seen[path]} already")
        seen.setdefault(path, number)
        for name, value in row.items():
            reason = unfit(name, value)
            if reason:
                wrong.append(f"{file}, row {number}, column {name}: {reason}")
        out.append((movie, path, row))
    if wrong:
        more = f"\nand {len(wrong) - SHOWN_ERRORS} more like these" if len(wrong) > SHOWN_ERRORS else ""
        raise ConfigError("\n".join(wrong[:SHOWN_ERRORS]) + more)
    if not out:
        raise ConfigError(f"{file}: expected a row for each movie; there is none below the header")
    return out


def check_names(where: str, names: list[str]) -> None:
    """Check the names of columns; raises ConfigError for one that is empty, there twice, or taken by the tables."""
    for i, name in enumerate(names):
        if not name:
            raise ConfigError(f"{where}: expected a name for each column; that of column {i + 1} is empty")
        if name in names[:i]:
            raise ConfigError(f"{where}, column {name}: expected each column once; it is there twice")
        if name in TAKEN:
            raise ConfigError(f"{where}, column {name}: the tables of the results have a column of that name; call "
                              "it otherwise")


def unfit(name: str, value: str) -> str:
    """Say what is wrong with the value of a column; nothing where it fits, or is empty."""
    if name not in SETTINGS or not value:
        return ""
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    return "" if number > 0 and math.isfinite(number) else f"expected a positive number; found {value!r}"


def settings_of(columns: Mapping[str, str]) -> dict[str, Any]:
    """Make nested settings of the columns that are settings."""
    out: dict[str, Any] = {}
    for name, (*above, last) in SETTINGS.items():
        if columns.get(name):
            inside = out
            for part in above:
                inside = inside.setdefault(part, {})
            inside[last] = float(columns[name])
    return out


def ordered(names: set[str], seen: list[str]) -> list[str]:
    """Put the columns into the order of the tables: places, settings, then the others as they were seen."""
    first = [name for name in (*PLACES, *SETTINGS) if name in names]
    return first + [name for name in seen if name not in first]


def _header(file: Path, cells: list[str]) -> list[str]:
    names = [cell.strip() for cell in cells]
    while names and not names[-1]:
        names.pop()
    lowered = [name.lower() if name.lower() in {MOVIE, *PLACES, *SETTINGS, *SHORT} else name for name in names]
    header = [SHORT.get(name, name) for name in lowered]
    if MOVIE not in header:
        raise ConfigError(f"{file}, row 1: expected a header with the column {MOVIE}; found "
                          f"{', '.join(names) or 'nothing'}")
    check_names(f"{file}, row 1", header)
    return header
