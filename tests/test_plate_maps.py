"""Plates: which value stands in which well, one scale for all, and pictures, workbook and page of them."""

from __future__ import annotations

import importlib.util
import json
import math
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import matplotlib
import openpyxl
import pytest

from microbundle.errors import ConfigError, OutputError
from microbundle.plate_maps import FOLDER, _wanted, draw_groups, draw_metric, write_maps
from microbundle.plate_workbook import write_plate_workbook
from microbundle.plates import Plate, State, WellMovie, groups_of, limits_of, plates_of
from microbundle.report import write_index
from microbundle.report.index import NoResult

AMPLITUDE = "amplitude_um"


def movie(well: str, state: State = "pass", mean: float = math.nan, plate: str = "P1", group: str = "a",
          **more: str) -> WellMovie:
    means = {AMPLITUDE: (mean, 0.1)} if math.isfinite(mean) else {}
    kind, message = ("MovieUnreadable", "cut off") if state == "failed" else ("", "")
    return WellMovie(f"{plate}_{well}", {"plate": plate, "well": well, "group": group, **more}, state, means, kind,
                     message, "" if state == "failed" else f"results/{plate}_{well}/report.html")


@pytest.fixture
def plates() -> list[Plate]:
    """Two plates of six wells: one with each kind of well, and one with larger values."""
    return plates_of([movie("A1", mean=2.0), movie("A2", "review", 3.0, group="b"), movie("A3", "fail", 99.0),
                      movie("B1", "failed", group="b"), movie("B3"), movie("A1", mean=8.1, plate="P2")])[0]


# --- which value stands where ---------------------------------------------------------------------------------------


def test_values_of_results_that_cannot_be_trusted_count_for_nothing(plates: list[Plate]) -> None:
    assert [(p.name, p.rows, p.columns) for p in plates] == [("P1", 2, 3), ("P2", 2, 3)]
    found = {well.name: (well.state, well.reading(AMPLITUDE)[0]) for well in plates[0].wells}
    assert found["A1"] == ("pass", 2.0)
    assert found["A2"] == ("review", 3.0)
    assert found["A3"][0] == "fail"
    assert all(math.isnan(found[name][1]) for name in ("A3", "B1", "B3"))
    assert "B2" not in found
    assert plates[0].failures == {"MovieUnreadable": 1}
    assert limits_of(plates, AMPLITUDE) == (2.0, 9.0)
    assert limits_of(plates, "cd50_s") is None
    assert groups_of(plates) == ["a", "b"]


def test_a_well_with_several_movies_has_the_mean_of_those_that_can_be_trusted() -> None:
    (plate,), left_out = plates_of([movie("A1", mean=2.0), movie("a01", mean=4.0), movie("A1", "fail", 50.0),
                                    movie("somewhere")])
    well, = plate.wells
    assert (well.state, well.reading(AMPLITUDE)[0], left_out) == ("review", 3.0, 1)
    assert math.isnan(well.reading(AMPLITUDE)[1])


def test_days_of_a_plate_are_plates_of_their_own() -> None:
    plates, _ = plates_of([movie("A1", day="7"), movie("A1", day="14"), movie("A1", plate="P2", day="7")])
    assert [plate.name for plate in plates] == ["P1 day 7", "P1 day 14", "P2"]
    with pytest.raises(ConfigError, match="plate of 6 wells"):
        plates_of([movie("H12")], 6)


@pytest.mark.parametrize(("values", "limits"), [((84.9, 117.2), (80, 120)), ((-0.055, -0.019), (-0.06, -0.01)),
                                                ((5.0, 5.0), (4.4, 5.6)), ((0.0, 0.0), (-0.1, 0.1))])
def test_limits_are_round_and_hold_all_values(values: tuple[float, ...], limits: tuple[float, float]) -> None:
    plates, _ = plates_of([movie(f"A{k + 1}", mean=value) for k, value in enumerate(values)])
    found = limits_of(plates, AMPLITUDE)
    assert found is not None
    assert found[0] <= min(values) <= max(values) <= found[1]
    assert found[1] - found[0] <= 1.5 * (limits[1] - limits[0])


# --- pictures -------------------------------------------------------------------------------------------------------


def test_a_map_has_each_number_in_its_well_and_says_why_others_have_none(plates: list[Plate]) -> None:
    axes = draw_metric(plates[0], AMPLITUDE, (2, 10)).axes[0]
    texts = {text.get_text(): text.get_position() for text in axes.texts}
    assert texts["2.00"] == pytest.approx((0.5, 0.52))
    assert texts["3.00"] == pytest.approx((1.5, 0.52))
    assert texts["Movie\nUnreadable"] == pytest.approx((0.5, 1.5))
    assert "99.0" not in texts
    said = next(text for text in texts if "Crossed" in text).replace("\n", " ")
    assert said == ("Corner: to be reviewed. Hatched: verdict fail. Crossed: no result (1 MovieUnreadable). "
                    "Blank: no movie.")
    assert [patch.get_hatch() is not None for patch in axes.patches].count(True) == 1


def test_all_plates_have_one_colour_scale(plates: list[Plate]) -> None:
    limits = limits_of(plates, AMPLITUDE)
    assert limits is not None
    figures = [draw_metric(plate, AMPLITUDE, limits) for plate in plates]
    assert all(figure.axes[1].get_ylim() == limits for figure in figures)
    wanted = matplotlib.colormaps["viridis"]((8.1 - limits[0]) / (limits[1] - limits[0]))
    assert figures[1].axes[0].patches[0].get_facecolor() == pytest.approx(wanted)


def test_groups_are_coloured_and_named(plates: list[Plate]) -> None:
    axes = draw_groups(plates[0], groups_of(plates)).axes[0]
    assert [text.get_text() for text in axes.texts].count("b") == 3  # two wells, and the legend
    many = [f"g{k}" for k in range(40)]
    crowded, _ = plates_of([movie(f"A{k + 1}", group=name) for k, name in enumerate(many)])
    assert any("more" in text.get_text() for text in draw_groups(crowded[0], many).axes[0].texts)


def test_maps_are_written_once_and_again_only_where_they_change(plates: list[Plate], tmp_path: Path) -> None:
    def written() -> list[str]:
        return sorted(file.name for file in folder.iterdir() if not file.name.startswith("."))

    folder = tmp_path / FOLDER
    assert write_maps([], [AMPLITUDE], tmp_path) is None
    assert not folder.exists()
    assert write_maps(plates[1:], [AMPLITUDE, "cd50_s"], tmp_path) == folder
    assert written() == [f"P2_{what}.{suffix}" for what in (AMPLITUDE, "groups") for suffix in ("pdf", "png")]
    before = {file: file.stat().st_mtime_ns for file in folder.iterdir()}
    write_maps(plates[1:], [AMPLITUDE], tmp_path)
    assert {file: file.stat().st_mtime_ns for file in folder.iterdir()} == before
    (folder / "P2_groups.png").unlink()
    other, _ = plates_of([movie("A1", mean=5.0, plate="P2")])
    write_maps(other, [AMPLITUDE], tmp_path)
    after = {file: file.stat().st_mtime_ns for file in folder.iterdir()}
    assert {file.name for file in after if after[file] != before.get(file)} >= {"P2_amplitude_um.png", "P2_groups.png"}
    assert write_maps([], [AMPLITUDE], tmp_path) is None
    assert written() == []


def test_plates_with_names_that_no_file_can_have(tmp_path: Path) -> None:
    plates, _ = plates_of([movie("A1", mean=1, plate="a/b", group=""), movie("A1", mean=2, plate="a:b", group=""),
                           movie("A1", mean=3, plate="", group="")])
    assert [name for name, _, _ in _wanted(plates, [AMPLITUDE])] == [
        "a_b_1_amplitude_um", "a_b_2_amplitude_um", "plate_amplitude_um"]
    (tmp_path / FOLDER).touch()
    with pytest.raises(OutputError, match="the plate maps cannot be written"):
        write_maps(plates, [AMPLITUDE], tmp_path)


# --- workbook -------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(importlib.util.find_spec("xlsxwriter") is None, reason="XlsxWriter is not installed")
def test_the_workbook_has_each_metric_in_the_geometry_of_the_plates(plates: list[Plate], tmp_path: Path) -> None:
    (tmp_path / "movies.csv").write_text("movie,well,dose_um,amplitude_um\n1,A1,0.3,2.5\n2,A2,,\n")
    (tmp_path / "plate.csv").write_text("movie,metric,mean\n1,amplitude_um,2.5\n")
    tables = {"movies": tmp_path / "movies.csv", "tidy": tmp_path / "plate.csv"}
    for _ in range(2):  # an older one is replaced
        file = write_plate_workbook(tmp_path, tables, plates, [AMPLITUDE], [("setting", "fps", 30, "")], ["look"])
    assert not list(tmp_path.glob(".*partial*"))
    book = openpyxl.load_workbook(file)
    assert book.sheetnames == ["movies", "tidy", AMPLITUDE, "groups", "settings", "notes", "metrics"]
    assert [[cell.value for cell in row] for row in book["movies"]] == [
        ["movie", "well", "dose_um", "amplitude_um"], ["1", "A1", 0.3, 2.5], ["2", "A2", None, None]]
    grid = [[cell.value for cell in row][:4] for row in book[AMPLITUDE]]
    assert grid[:4] == [["P1: amplitude_um", None, None, None], [None, 1, 2, 3], ["A", 2, 3, "fail"],
                        ["B", "MovieUnreadable", None, None]]
    assert grid[5][0] == "P2: amplitude_um"
    assert grid[7][1] == 8.1
    assert [cell.value for cell in book["groups"][3]][:3] == ["A", "a", "b"]
    assert "look" in [row[0].value for row in book["notes"]]
    assert len(book[AMPLITUDE].conditional_formatting) > 0


# --- page -----------------------------------------------------------------------------------------------------------


class Cells(HTMLParser):
    """Text of every cell of the page's tables."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.cells: list[str] = []
        self.open = False
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: Any) -> None:  # noqa: ARG002
        self.open = tag in ("td", "th", "caption") or (self.open and tag not in ("table", "tr"))
        if tag in ("td", "th", "caption"):
            self.cells.append("")

    def handle_data(self, data: str) -> None:
        if self.open and self.cells:
            self.cells[-1] += data


def data_of(page: str) -> Any:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.S)
    assert found is not None
    return json.loads(found[1])


def test_the_page_shows_plates_without_scripts_and_gives_scripts_the_same(plates: list[Plate], tmp_path: Path) -> None:
    failed = NoResult("P1_B1", "MovieUnreadable", "cut <off>", {"well": "B1"})
    page = write_index([failed], tmp_path / "i.html", plates=plates, metrics=[AMPLITUDE, "cd50_s"]).read_text("utf-8")
    cells = Cells(page).cells
    at = cells.index("P1: Contraction amplitude (µm)")
    assert cells[at + 5:at + 13] == ["A", "2.00", "3.00", "fail", "B", "no result", "", "–"]
    assert "1 movie: 0 pass, 0 review, 0 fail, 1 without a result." in page
    assert any("No result" in cell and "MovieUnreadable: cut <off>" in cell for cell in cells)
    data = data_of(page)
    assert [metric["name"] for metric in data["metrics"]] == ["Contraction amplitude"]
    assert (data["metrics"][0]["low"], data["metrics"][0]["high"]) == limits_of(plates, AMPLITUDE)
    first, second, *_ = data["plates"][0]["wells"]
    assert (first["place"], first["values"], first["report"]) == ([0, 0], [[2.0, 0.1]], "results/P1_A1/report.html")
    assert second["told"] == ["to be reviewed"]
    assert data["plates"][0]["wells"][3]["told"] == ["no result: MovieUnreadable: cut off"]


def test_a_page_without_plates_has_no_room_for_them(tmp_path: Path) -> None:
    page = write_index([NoResult("x", "NoTissue", "none")], tmp_path / "i.html").read_text("utf-8")
    assert 'id="plates"' not in page
    assert data_of(page) == {}


def test_a_thousand_movies_make_a_small_page(tmp_path: Path) -> None:
    movies = [movie(f"{'ABCDEFGHIJKLMNOP'[k // 24]}{k % 24 + 1}", mean=5 + k / 384) for k in range(384)]
    plates, _ = plates_of(movies)
    page = write_index([NoResult(one.movie, "x", "y", one.columns) for one in movies], tmp_path / "i.html",
                       plates=plates, metrics=[AMPLITUDE])
    assert plates[0].rows * plates[0].columns == 384
    assert page.stat().st_size < 500_000
