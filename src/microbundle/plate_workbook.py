"""One Excel workbook of a run over many movies: its tables, each metric in the geometry of the plates, its settings.

Cells without a value say why: blank, the well has no movie; `fail`, its numbers cannot be trusted; else the kind of the
failure. All plates of a run stand on one sheet for each metric, under one colour scale.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from .errors import OutputError
from .plates import Plate, Well, groups_of
from .report.terms import term_of
from .wells import row_name
from .workbook import DIGITS, Sheets, check_writer, number_format

NAME, TIDY = "plate.xlsx", "tidy"
TEXTS = ("movie", "plate", "well", "group", "metric", "verdict", "state", "failure_kind", "failure", "result")
"""Columns that stay text, whatever they look like."""
LOW, HIGH = "#FFFFFF", "#5AA9C9"
"""Colours that black numbers are read on."""
LONGEST_TITLE = 31
"""Letters of a sheet's name."""


def write_plate_workbook(out: Path, tables: Mapping[str, Path], plates: Sequence[Plate], metrics: Sequence[str],
                         about: Iterable[Sequence[Any]], notes: Iterable[str] = ()) -> Path:
    """Write the workbook of a run into its folder, in place of an older one, and return its path.

    `tables` are the run's CSV tables by the name of their sheet, `about` rows of part, name, value and meaning. Raises
    ConfigError where XlsxWriter is not installed, OutputError where the file cannot be written; nothing is left then.
    """
    check_writer()
    import xlsxwriter

    path = out / NAME
    handle, partial = tempfile.mkstemp(prefix=f".{NAME}.partial-", dir=out)
    os.close(handle)
    try:
        with xlsxwriter.Workbook(partial, {"constant_memory": True, "nan_inf_to_errors": False}) as book:
            book.set_properties({"title": f"microbundle run {out.name}"})
            sheets = Sheets(book)
            for name, table in tables.items():
                sheets.table(name, _read(table), by_cell=name == TIDY)
            for metric in metrics if plates else ():
                _matrices(sheets, metric[:LONGEST_TITLE], metric, plates)
            if groups_of(plates):
                _matrices(sheets, "groups", None, plates)
            sheets.rows("settings", ("part", "name", "value", "meaning"), list(about))
            sheets.rows("notes", ("note",), [(note,) for note in [*_reading(bool(plates)), *notes]])
            sheets.rows("metrics", ("column", "unit", "definition"), [
                (metric, term_of(metric).unit or "1", term_of(metric).metric.definition) for metric in metrics])
        Path(partial).chmod(0o644)
        os.replace(partial, path)
    except (OSError, xlsxwriter.exceptions.FileCreateError) as error:
        raise OutputError(f"{path}: the workbook cannot be written: {getattr(error, 'strerror', None) or error}"
                          ) from None
    finally:
        Path(partial).unlink(missing_ok=True)
    return path


def _read(table: Path) -> Any:
    """Read a CSV table; columns that hold nothing but numbers become numbers."""
    import pandas as pd

    read = pd.read_csv(table, dtype=str, keep_default_na=False)
    for name in read.columns:
        if name not in TEXTS and (read[name] != "").any():
            numbers = pd.to_numeric(read[name].where(read[name] != ""), errors="coerce")
            if numbers.notna().sum() == (read[name] != "").sum():
                read[name] = numbers
    return read


def _matrices(sheets: Sheets, title: str, metric: str | None, plates: Sequence[Plate]) -> None:
    """Write a sheet with each plate as it stands on the bench: a metric, or the groups."""
    sheet = sheets.book.add_worksheet(title)
    sheet.set_column(0, 0, 5)
    sheet.set_column(1, max(plate.columns for plate in plates), 10 if metric else 14)
    bold, head = sheets.style(bold=True), sheets.style(bold=True, bg_color="#E7E6E6", align="center")
    what = "groups" if metric is None else metric
    values = [value for plate in plates for well in plate.wells
              if metric and math.isfinite(value := well.reading(metric)[0])]
    shown = sheets.style(num_format=number_format(values, DIGITS - 1) or "General", align="center")
    said = sheets.style(align="center", font_color="#7F7F7F", font_size=9)
    row, grids = 0, []
    for plate in plates:
        sheet.write_string(row, 0, f"{plate.name}: {what}" if plate.name else what, bold)
        for column in range(plate.columns):
            sheet.write_number(row + 1, column + 1, column + 1, head)
        wells = {well.place: well for well in plate.wells}
        for r in range(plate.rows):
            sheet.write_string(row + 2 + r, 0, row_name(r), head)
            for c in range(plate.columns):
                if (r, c) in wells:
                    found = _value(wells[r, c], metric)
                    if isinstance(found, float):
                        sheet.write_number(row + 2 + r, c + 1, float(f"{found:.7g}"), shown)
                    elif found:
                        sheet.write_string(row + 2 + r, c + 1, found, said if metric else sheets.style(align="center"))
        grids.append((row + 2, 1, row + 1 + plate.rows, plate.columns))
        row += plate.rows + 3
    if values and len(set(values)) > 1:
        scale = {"type": "2_color_scale", "min_color": LOW, "max_color": HIGH, "min_type": "num", "max_type": "num",
                 "min_value": min(values), "max_value": max(values)}
        for grid in grids:
            sheet.conditional_format(*grid, scale)


def _value(well: Well, metric: str | None) -> float | str:
    """What stands in the cell of a well."""
    if metric is None:
        return well.group
    value = well.reading(metric)[0]
    if math.isfinite(value):
        return value
    return {"failed": well.kind, "fail": "fail"}.get(well.state, "")


def _reading(plates: bool) -> list[str]:
    """How the sheets are to be read."""
    out = ["Numbers are means over the whole beats of a movie; the sheet tidy has their standard errors and intervals.",
           "Leave out movies with the verdict fail before groups are compared: their numbers cannot be trusted."]
    if plates:
        out.append("On the sheets of plates a blank cell has no movie, `fail` is a verdict, and other words are the "
                   "kind of a failure, which the sheet movies explains.")
    return out
