"""One Excel workbook of a result: every table on a sheet, the findings, and how the result was made.

Numbers keep the seven digits of the CSV tables and show four; what is not known is an empty cell. Headers are the
columns of the CSV tables, which carry the units; the sheet `metrics` defines each.
"""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .analysis import Analysis
from .compat_definitions import TOOLS
from .config import Params
from .dictionary import IDENTITY, METRICS, columns
from .errors import ConfigError, OutputError
from .metrics import tables
from .numbers import seconds_per_frame

if TYPE_CHECKING:
    import pandas as pd

NAME = "results.xlsx"
SHEETS = {"summary": "summary", "subdomain_summary": "sub-domains, summary", "pillar_summary": "pillars, summary",
          "beats": "beats", "shortening": "shortening", "subdomains": "sub-domains", "pillars": "pillars",
          "frames": "traces (frames)", "strain": "strain", "pillar_frames": "pillar traces"}
"""Tables and the names of their sheets, in order; tables that are not listed follow under their own names."""
BUDGET = "budget"
MOST_ROWS = 1_048_575
"""Below the header, in a sheet of this format."""
KEPT, DIGITS, ERROR_DIGITS = 7, 4, 2
"""Digits that are kept, that are shown, and that are shown of errors and spreads."""
ERRORS = {"se", "sd", "cv"}
NARROWEST, WIDE, WIDEST = 9, 28, 80
"""Widths of a column: the least, the most for its header, and the most for its texts."""
TINT = {"pass": "#C6EFCE", "review": "#FFEB9C", "fail": "#FFC7CE"}


def check_writer() -> None:
    """Check that workbooks can be written; raises ConfigError that says how to install the writer."""
    from importlib.util import find_spec

    if find_spec("xlsxwriter") is None:
        raise ConfigError("Excel: expected the package XlsxWriter; it is not installed. Install it with "
                          'pip install "microbundle[excel]", or leave --excel out: the CSV tables open in Excel too')


def write_workbook(analysis: Analysis, path: Path | str, made: Mapping[str, pd.DataFrame] | None = None) -> Path:
    """Write a result as one Excel workbook into a new file, and return its path.

    `made` are the tables of `microbundle.tables`, where they are at hand, and others that get a sheet each. A table of
    more than 1,048,575 rows goes on in a second sheet. Raises ConfigError where XlsxWriter is not installed, and
    OutputError where the file exists or cannot be written; nothing is left then.
    """
    check_writer()
    made = tables(analysis) if made is None else made
    path = Path(path).expanduser()
    if path.exists():
        raise OutputError(f"{path}: expected a new file for the workbook; it exists, and is never replaced")
    try:
        with tempfile.TemporaryDirectory(prefix=f".{path.name}.partial-", dir=path.parent) as folder:
            partial = Path(folder) / path.name
            _write(analysis, partial, made)
            partial.rename(path)
    except OSError as error:
        raise OutputError(f"{path}: the workbook cannot be written: {error.strerror or error}") from None
    return path


def _write(analysis: Analysis, path: Path, made: Mapping[str, pd.DataFrame]) -> None:
    import xlsxwriter

    # Rows go to the disk one by one, so that long traces take no memory.
    with xlsxwriter.Workbook(path, {"constant_memory": True, "nan_inf_to_errors": False}) as book:
        book.set_properties({"title": f"microbundle analysis of {analysis.name}"})
        sheets = Sheets(book)
        for name in [*SHEETS, *(n for n in made if n not in SHEETS and n != BUDGET)]:
            if name in made and len(made[name].columns):
                sheets.table(SHEETS.get(name, name), made[name], by_cell=name == "summary")
        _quality(sheets, analysis)
        if BUDGET in made and len(made[BUDGET]):
            sheets.table("error budget", made[BUDGET])
        sheets.rows("settings", ("part", "name", "value", "meaning"), _settings(analysis))
        sheets.rows("metrics", ("column", "unit", "definition"), _definitions(analysis, made))


class Sheets:
    """A workbook that is being written, and its formats."""

    def __init__(self, book: Any) -> None:
        self.book = book
        self.known: dict[tuple[Any, ...], Any] = {}

    def style(self, **look: Any) -> Any:
        """A format, made once."""
        key = tuple(sorted(look.items()))
        if key not in self.known:
            self.known[key] = self.book.add_format(look)
        return self.known[key]

    def table(self, title: str, table: pd.DataFrame, *, by_cell: bool = False) -> None:
        """Write a table, with a number format for each column, or for each cell where rows differ in their units."""
        header = [str(name) for name in table.columns]
        digits = [ERROR_DIGITS if ERRORS & set(name.split("_")) else DIGITS for name in header]
        shown = [number_format(table[name].tolist(), few) for name, few in zip(table.columns, digits, strict=True)]
        held = next((c for c, name in enumerate(header) if name not in IDENTITY), 1)
        for part, first in enumerate(range(0, max(len(table), 1), MOST_ROWS)):
            here = table.iloc[first:first + MOST_ROWS]
            texts = [name for name, how in zip(header, shown, strict=True) if how is None]
            sheet = self._sheet(title if part == 0 else f"{title} {part + 1}", header,
                                {name: here[name].head(1000).tolist() for name in texts}, held=max(held, 1))
            for r, row in enumerate(here.itertuples(index=False, name=None), start=1):
                for c, value in enumerate(row):
                    how = number_format([value], digits[c]) if by_cell and shown[c] else shown[c]
                    self._cell(sheet, r, c, value, how)

    def rows(self, title: str, header: Sequence[str], rows: Iterable[Sequence[Any]], top: Sequence[Any] = ()) -> None:
        """Write rows of text and numbers, below a verdict and further rows of text on `top`."""
        rows = list(rows)
        texts = {name: [row[c] for row in rows] for c, name in enumerate(header)}
        sheet = self._sheet(title, header, texts, top)
        for r, row in enumerate(rows, start=len(top) + 1):
            for c, value in enumerate(row):
                self._cell(sheet, r, c, value, number_format([value]))

    def _sheet(self, title: str, header: Sequence[str], texts: Mapping[str, Sequence[Any]],
               top: Sequence[Any] = (), held: int = 1) -> Any:
        """Add a sheet with its header, wide enough for it and for texts, which stays in view with `held` columns."""
        sheet = self.book.add_worksheet(title)
        for c, name in enumerate(header):
            longest = max((len(str(text)) for text in texts.get(name, ())), default=0)
            sheet.set_column(c, c, max(min(len(name) + 2, WIDE), min(longest + 2, WIDEST), NARROWEST))
        for r, (cells, look) in enumerate(top):
            sheet.write_row(r, 0, cells, self.style(**look))
        sheet.write_row(len(top), 0, header, self.style(bold=True, bottom=1, bg_color="#E7E6E6", text_wrap=True,
                                                         valign="top"))
        sheet.freeze_panes(len(top) + 1, held)
        return sheet

    def _cell(self, sheet: Any, row: int, column: int, value: Any, how: str | None) -> None:
        value = value.item() if hasattr(value, "item") else value
        if isinstance(value, bool):
            sheet.write_boolean(row, column, value, self.style(valign="top"))
        elif isinstance(value, int | float):
            if math.isfinite(value):
                look = self.style(num_format=how or "General", valign="top")
                sheet.write_number(row, column, float(f"{value:.{KEPT}g}"), look)
        elif value is not None and value != "":
            sheet.write_string(row, column, str(value), self.style(text_wrap=True, valign="top"))


def number_format(values: Sequence[Any], digits: int = DIGITS) -> str | None:
    """Choose the format that shows so many digits of the usual number among values, and, of numbers that lie close to
    each other, also three digits of their range; None where there are no numbers."""
    numbers = [float(v) for v in values if isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v)]
    if not numbers:
        return None
    if all(v == round(v) and abs(v) < 1e9 for v in numbers):
        return "0"
    sizes = sorted(abs(v) for v in numbers if v)
    power, span = math.floor(math.log10(sizes[len(sizes) // 2])), max(numbers) - min(numbers)
    if not -5 <= power <= 6:
        return f"0.{'0' * (digits - 1)}E+00"
    decimals = max(digits - 1 - power, 0)
    if span > 1e-6 * sizes[-1] and digits > ERROR_DIGITS:
        decimals = max(decimals, min(2 - math.floor(math.log10(span)), decimals + 2))
    return f"0.{'0' * decimals}" if decimals else "0"


def _quality(sheets: Sheets, analysis: Analysis) -> None:
    """The verdict, and each finding with its number and limit."""
    counts = [f"{sum(f.level == level for f in analysis.findings)} {level}" for level in ("fail", "review", "info")]
    verdict = {"bold": True, "font_size": 14, "bg_color": TINT[analysis.verdict]}
    top = [(("verdict", analysis.verdict), verdict), (("findings", ", ".join(counts)), {}), ((), {})]
    sheets.rows("quality", ("level", "finding", "number", "limit", "message"),
                [(f.level, f.key, f.value, f.limit, f.message) for f in analysis.findings], top)


def _settings(analysis: Analysis) -> Iterator[tuple[str, str, Any, str]]:
    """Everything that says how the result was made: part, name, value, meaning."""
    step = seconds_per_frame(analysis)
    yield "movie", "name", analysis.name, ""
    yield "movie", "frames", analysis.frame_count, ""
    yield ("calibration", "um_per_px", "not known" if analysis.um_per_px is None else analysis.um_per_px,
           f"size of a pixel in micrometres; source: {analysis.um_per_px_source}")
    yield ("calibration", "fps", "not known" if step is None else 1 / step,
           f"frames per second, by the median time between frames; source: {analysis.time_source}")
    yield from (("setting", *one) for one in settings(analysis.config))
    yield from (("version", name, version, "") for name, version in analysis.versions.items())
    yield "input", "sha256", analysis.input_hash or "not known", "over the movie's files"
    yield from (("input", "file", file, "") for file in analysis.files)


def settings(params: Params, above: str = "") -> Iterator[tuple[str, Any, str]]:
    """Every setting of a tree: its name as in a TOML file, its value, and its help text on one line."""
    for name, field in type(params).model_fields.items():
        value = getattr(params, name)
        if isinstance(value, Params):
            yield from settings(value, f"{above}{name}.")
            continue
        if not isinstance(value, int | float | str):
            value = "not set" if value is None else json.dumps(value)
        yield above + name, value, " ".join((field.description or "").split())


def _definitions(analysis: Analysis, made: Mapping[str, pd.DataFrame]) -> Iterator[tuple[str, str, str]]:
    """Unit and definition of each column that is written, without those of the standard errors."""
    written = {str(name) for table in made.values() for name in table.columns}
    if "summary" in made:
        written |= {str(name) for name in made["summary"]["metric"]}
    for metric in METRICS:
        for name, _ in columns(metric, analysis.um_per_px, seconds_per_frame(analysis)):
            if name in written:
                yield name, name.removeprefix(metric.key).removeprefix("_") or "1", metric.definition
                written.discard(name)
    for tool, about in TOOLS.items():
        if f"compat_{tool}" in made:
            yield f"compat_{tool}", "", f"The columns of {about.title}, in its words: docs/compat.md. {about.signal}"
