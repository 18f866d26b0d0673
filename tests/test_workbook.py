"""The Excel workbook, read back with another program: the numbers of the tables, units, and what a reader looks for."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pandas as pd
import pytest

from microbundle import workbook
from microbundle.analysis import Analysis
from microbundle.compat import compat_columns
from microbundle.config import Config
from microbundle.data import Finding
from microbundle.dictionary import IDENTITY, METRICS, columns
from microbundle.errors import ConfigError, OutputError
from microbundle.metrics import tables
from microbundle.workbook import number_format, settings, write_workbook

from .known_pillars import with_pillars

Tables = dict[str, pd.DataFrame]


@pytest.fixture(scope="module")
def analysis(tissue_analysis: Analysis) -> Analysis:
    """A result with pillars, a file and a finding with a number."""
    finding = Finding("large_residual", "review", "look at the peaks", 0.1234567890123, 0.2)
    return replace(with_pillars(tissue_analysis, noise_px=0.01), movie_findings=(finding,), files=("a b.tif",))


@pytest.fixture(scope="module")
def made(analysis: Analysis) -> Tables:
    return tables(analysis) | {"compat_pulse3d": compat_columns(analysis, "pulse3d")}


@pytest.fixture(scope="module")
def file(analysis: Analysis, made: Tables, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_workbook(analysis, tmp_path_factory.mktemp("book") / "results.xlsx", made)


@pytest.fixture(scope="module")
def book(file: Path) -> Any:
    return openpyxl.load_workbook(file)


def texts(column: pd.Series) -> list[str]:
    return ["" if pd.isna(value) else str(value) for value in column]


def test_every_table_has_a_sheet_in_the_order_of_reading(book: Any) -> None:
    assert book.sheetnames == ["summary", "sub-domains, summary", "pillars, summary", "beats", "shortening",
                               "sub-domains", "pillars", "traces (frames)", "strain", "pillar traces",
                               "compat_pulse3d", "quality", "error budget", "settings", "metrics"]


def test_sheets_hold_the_numbers_of_the_tables(file: Path, made: Tables) -> None:
    for name, title in {**workbook.SHEETS, "compat_pulse3d": "compat_pulse3d", "budget": "error budget"}.items():
        found = pd.read_excel(file, sheet_name=title, dtype={"pillar": str}, keep_default_na=True)
        wanted = made[name].replace("", np.nan)
        assert list(found.columns) == list(wanted.columns)
        for column in wanted.columns:
            if wanted[column].dtype.kind in "if":
                np.testing.assert_allclose(found[column].astype(float), wanted[column].astype(float), rtol=1e-6)
            else:
                assert texts(found[column]) == texts(wanted[column])


def test_what_is_not_known_is_an_empty_cell(book: Any, made: Tables) -> None:
    sheet, table = book["beats"], made["beats"]
    place = list(table.columns).index("beat_period_s")
    assert np.isnan(table["beat_period_s"].iloc[-1])
    assert sheet.cell(len(table) + 1, place + 1).value is None
    cells = [cell.value for page in book for row in page.iter_rows() for cell in row]
    assert not any(str(value).lower() in ("nan", "inf", "#num!", "#div/0!", "none", "") for value in cells
                   if value is not None)


def test_numbers_are_short_and_shown_with_a_format(book: Any) -> None:
    for page in book:
        for row in page.iter_rows(min_row=2, max_row=40):
            for cell in row:
                if isinstance(cell.value, float):
                    assert len(repr(cell.value).replace("-", "").replace(".", "").lstrip("0").split("e")[0]) <= 7
                    assert cell.number_format.startswith("0")
    assert book["beats"]["G2"].number_format.startswith("0.00")


def test_headers_carry_units_and_stay_in_view(book: Any, analysis: Analysis) -> None:
    step = 1 / 30
    known = {name for m in METRICS for error in (False, True)
             for name, _ in columns(m, analysis.um_per_px, step, error=error)}
    for title in workbook.SHEETS.values():
        page = book[title]
        header = [cell.value for cell in page[1]]
        assert page.freeze_panes.endswith("2")
        assert all(cell.font.bold for cell in page[1])
        widths = [page.column_dimensions[cell.column_letter].width for cell in page[1]]
        assert all(9 <= width <= 81 for width in widths)
        if "summary" not in title:
            assert {name for name in header if name not in known} <= {*IDENTITY, "markers"}
    assert "amplitude_um" in [cell.value for cell in book["beats"][1]]
    assert book["sub-domains"].freeze_panes == "E2"


def test_the_verdict_is_on_top_of_the_findings(book: Any, analysis: Analysis) -> None:
    page = book["quality"]
    assert [page["A1"].value, page["B1"].value] == ["verdict", analysis.verdict]
    assert page["B1"].font.bold
    assert page["B1"].fill.fgColor.rgb == "FFFFEB9C"
    assert page["B2"].value == "0 fail, 1 review, 0 info"
    assert [cell.value for cell in page[4]] == ["level", "finding", "number", "limit", "message"]
    assert [cell.value for cell in page[5]] == ["review", "large_residual", 0.1234568, 0.2, "look at the peaks"]
    assert page.freeze_panes == "B5"


def test_settings_and_how_the_result_was_made(book: Any) -> None:
    rows = [[cell.value for cell in row] for row in book["settings"].iter_rows(min_row=2)]
    found = {(part, name): (value, meaning) for part, name, value, meaning in rows}
    assert found["calibration", "um_per_px"] == (4, "size of a pixel in micrometres; source: user")
    assert found["calibration", "fps"][0] == 30
    assert found["setting", "pillars.stiffness_un_per_um"][0] == 2.677
    assert found["setting", "tracking.window_px"][0] == "not set"
    assert found["setting", "metrics.levels_pct"][0] == "[10, 50, 90]"
    assert all(meaning for (part, _), (_, meaning) in found.items() if part == "setting")
    assert ("version", "numpy") in found
    assert found["input", "file"][0] == "a b.tif"
    assert len(list(settings(Config()))) == sum(part == "setting" for part, _ in found)


def test_each_column_is_defined(book: Any, made: Tables) -> None:
    rows = {row[0].value: (row[1].value, row[2].value) for row in book["metrics"].iter_rows(min_row=2)}
    assert rows["amplitude_um"][0] == "um"
    assert rows["F_cc"][0] == "1"
    for name in ("beats", "shortening", "subdomains", "pillars", "frames", "strain", "pillar_frames"):
        values = {c for c in made[name].columns if "_se" not in c and c not in IDENTITY}
        assert values <= set(rows)
    assert set(made["summary"]["metric"]) <= set(rows)


def test_a_result_without_calibration_pillars_or_strain(tissue_analysis: Analysis, tmp_path: Path) -> None:
    bare = replace(tissue_analysis, um_per_px=None, time_s=None, strain=None)
    book = openpyxl.load_workbook(write_workbook(bare, tmp_path / "b.xlsx"))
    assert not {"strain", "sub-domains", "pillars", "error budget"} & set(book.sheetnames)
    assert "amplitude_px" in [cell.value for cell in book["beats"][1]]
    rows = {row[1].value: row[2].value for row in book["settings"].iter_rows(min_row=2, max_row=5)}
    assert (rows["um_per_px"], rows["fps"]) == ("not known", "not known")


def test_long_tables_go_on_in_another_sheet(tissue_analysis: Analysis, tmp_path: Path,
                                            monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workbook, "MOST_ROWS", 50)
    file = write_workbook(tissue_analysis, tmp_path / "b.xlsx")
    first, second = (pd.read_excel(file, sheet_name=name) for name in ("traces (frames)", "traces (frames) 2"))
    assert list(first["frame"]) + list(second["frame"]) == list(range(75))


@pytest.mark.parametrize(("values", "shown"), [
    ([1, 2, np.int64(3)], "0"), ([1.0, 2.0], "0"), ([0.5, 0.61], "0.0000"), ([31.4, 22.9, np.nan], "0.00"),
    ([1.0001, 1.0002, 1.0003], "0.00000"), ([1e-9, 2e-9], "0.000E+00"), ([3e8 + 0.5], "0.000E+00"), ([np.nan], None),
    (["a", True, None], None), ([333.3, 333.3 + 1e-12], "0.0"),
])
def test_formats_show_four_digits(values: list[Any], shown: str | None) -> None:
    assert number_format([v.item() if hasattr(v, "item") else v for v in values]) == shown


def test_errors_show_two_digits() -> None:
    assert number_format([0.0123, 0.0187], 2) == "0.000"


def test_an_existing_file_is_never_replaced(analysis: Analysis, made: Tables, tmp_path: Path) -> None:
    (tmp_path / "mine.xlsx").write_text("mine")
    with pytest.raises(OutputError, match=r"mine\.xlsx: expected a new file"):
        write_workbook(analysis, tmp_path / "mine.xlsx", made)
    assert (tmp_path / "mine.xlsx").read_text() == "mine"
    with pytest.raises(OutputError, match="cannot be written"):
        write_workbook(analysis, tmp_path / "nowhere" / "b.xlsx", made)
    assert [p.name for p in tmp_path.iterdir()] == ["mine.xlsx"]


def test_without_the_writer_it_says_how_to_install_it(analysis: Analysis, tmp_path: Path,
                                                      monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(ConfigError, match=r'pip install "microbundle\[excel\]"'):
        write_workbook(analysis, tmp_path / "b.xlsx", {})
    assert list(tmp_path.iterdir()) == []
