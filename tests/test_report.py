"""Reports: complete, small, the same from the result file, safe whatever the names are, and never an empty box."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from microbundle import cli, pipeline
from microbundle.analysis import Analysis
from microbundle.config import Config
from microbundle.data import Finding
from microbundle.errors import ConfigError, OutputError, ResultUnreadable
from microbundle.folder import check_free
from microbundle.metrics import tables
from microbundle.report import NAME, write_index, write_report
from microbundle.report.build import report_page
from microbundle.report.index import summarize
from microbundle.report.page import embedded, number, with_error
from microbundle.report.sections import CARDS
from microbundle.report.text import PAPER, changed_settings, methods_paragraph
from microbundle.report.traces import FULL, UNKNOWN, displacement, rounded
from microbundle.store import KIND, RESULT, load, save

from .known_pillars import with_pillars

HOSTILE = '</script><script>alert("1")</script><img src=x onerror=alert(2)> & \u2028 \'"'
LARGEST = 6_000_000
Tables = dict[str, pd.DataFrame]


class Reader(HTMLParser):
    """The elements and the text of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.inside: list[str] = []
        self.kept: dict[str, str] = {}

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self.inside.append(tag)

    def handle_endtag(self, tag: str) -> None:
        while self.inside and self.inside.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        last = self.inside[-1] if self.inside else ""
        if last in ("script", "style"):
            kind = self.elements[-1][1].get("type") or last
            self.kept[kind] = self.kept.get(kind, "") + data
        else:
            self.text += data


def read(page: str) -> Reader:
    reader = Reader()
    reader.feed(page)
    return reader


def with_report(analysis: Analysis, made: Tables, into: Path) -> None:
    """Write a report into a result folder that is being filled."""
    write_report(analysis, into / NAME, made=made)


def data_of(page: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(read(page).kept["application/json"])
    return found


@pytest.fixture(scope="module")
def made(tissue_analysis: Analysis) -> Tables:
    """Tables of the small tissue."""
    return tables(tissue_analysis)


@pytest.fixture(scope="module")
def page(tissue_analysis: Analysis, made: Tables) -> str:
    """The report of the small tissue, which has no pillars."""
    return report_page(tissue_analysis, made)


@pytest.fixture(scope="module")
def pillar_page(tissue_analysis: Analysis) -> str:
    """The report of the small tissue with two pillars of known force."""
    return report_page(with_pillars(tissue_analysis, noise_px=0.01))


# --- what is in it ----------------------------------------------------------------------------------------------------


def test_findings_come_first_with_number_and_limit(tissue_analysis: Analysis, made: Tables) -> None:
    finding = Finding("odd_thing", "review", "Something is odd: look at it.", 12.5, 3.0)
    found = read(report_page(replace(tissue_analysis, movie_findings=(finding, *tissue_analysis.movie_findings)),
                             made))
    for one in tissue_analysis.findings:
        assert one.message[1:] in found.text
    assert finding.message in found.text
    assert "found 12.5, limit 3" in found.text
    assert "Review" in found.text
    assert found.text.index("Something is odd") < found.text.index("Means over whole beats")


def test_key_metrics_are_there_with_interval_unit_and_definition(made: Tables, page: str) -> None:
    summary = made["summary"].set_index("metric")
    found = read(page)
    for name, unit in (("beat_rate_bpm", "beats/min"), ("amplitude_um", "µm"), ("cd50_s", "s"), ("e_cc_peak", "")):
        row = summary.loc[name]
        assert f"{number(row['mean'])} {unit}" in found.text
        assert f"95 % {number(row['low_95'])} to {number(row['high_95'])}" in found.text
    tips = [attributes["data-tip"] or "" for _, attributes in found.elements if "data-tip" in attributes]
    assert any("60 / beat_period in seconds" in tip and "beats per minute" in tip for tip in tips)


def test_every_card_names_a_column_of_the_dictionary() -> None:
    from microbundle.dictionary import METRICS, columns

    known = {name for um in (None, 1.0) for s in (None, 1.0) for metric in METRICS
             for name, _ in columns(metric, um, s)}
    assert {name for choices in CARDS for name in choices} <= known


def test_pillars_show_force_loop_table_and_budget(pillar_page: str) -> None:
    found, data = read(pillar_page), data_of(pillar_page)
    assert [s["title"] for s in data["signals"]] == ["Mean displacement", "Fractional shortening", "Pillar force"]
    assert data["signals"][2]["unit"] == "µN"
    assert [line["name"] for line in data["signals"][2]["lines"]] == ["pillar 1", "pillar 2"]
    assert max(y for y in data["signals"][2]["lines"][0]["y"]) == pytest.approx(1.5 * 4 * 2.677, rel=0.05)
    assert len(data["loop"]["x"]) == len(data["time"])
    assert "What the forces are uncertain by" in found.text
    assert "pillar 2, beat 1" in found.text


def test_pillars_without_stiffness_show_deflection(tissue_analysis: Analysis) -> None:
    analysis = replace(with_pillars(tissue_analysis), config=Config())
    data = data_of(report_page(analysis))
    assert data["signals"][2]["title"] == "Pillar deflection"
    assert data["signals"][2]["unit"] == "µm"


def test_traces_are_those_of_the_tables(tissue_analysis: Analysis, made: Tables, page: str) -> None:
    data = data_of(page)
    np.testing.assert_allclose(data["signals"][0]["lines"][0]["y"],
                               made["frames"]["mean_absolute_displacement_um"], rtol=1e-3)
    assert tissue_analysis.strain is not None
    np.testing.assert_allclose(np.array(data["strain"]["E"]["cc"], float), tissue_analysis.strain.E[..., 1, 1],
                               rtol=1e-3, atol=1e-12)
    assert len(data["beats"]) == len(tissue_analysis.beats)


def test_the_map_gives_the_displacement_back(tissue_analysis: Analysis) -> None:
    found = displacement(tissue_analysis)
    assert found is not None
    coded = np.frombuffer(base64.b64decode(found["data"]), "<i2").reshape(found["count"], -1, 2)
    along = tissue_analysis.masks.axis.direction
    moved = np.where(coded == UNKNOWN, np.nan, coded * found["px_size"])
    back = moved[..., :1] * along + moved[..., 1:] * np.array([along[1], -along[0]])
    np.testing.assert_allclose(back, tissue_analysis.grid.displacement_px, atol=2 * np.nanmax(np.abs(back)) / FULL)
    rows, cols = np.divmod(np.arange(coded.shape[1]), found["cols"])
    place = np.array(found["origin"]) + rows[:, None] * found["row_step"] + cols[:, None] * np.array(found["col_step"])
    np.testing.assert_allclose(place, tissue_analysis.grid.point_px + 0.5, atol=1e-3)


def test_methods_name_what_was_done(tissue_analysis: Analysis) -> None:
    text = methods_paragraph(tissue_analysis)
    for part in ("75 frames of 128 × 192 px", "30 frames/s (as given by the user)", "4 µm/px", "B-spline",
                 "whole beats", "strain.tile_px = 20", "32 random draws", "[1]", "[2]"):
        assert part in text
    assert changed_settings(Config()) == {}
    assert changed_settings(Config.from_dict({"strain": {"tile_px": 20}})) == {"strain.tile_px": 20.0}


def test_the_paper_cited_is_that_of_the_citation_file() -> None:
    listed = (Path(__file__).parents[1] / "CITATION.cff").read_text(encoding="utf-8")
    title = re.search(r'- type: article\s+title: "(.*)"', listed)
    assert title is not None
    assert title[1] in PAPER
    for name in re.findall(r"family-names: (\w+)", listed):
        assert name in PAPER


# --- small, self-contained, safe --------------------------------------------------------------------------------------


def test_a_page_is_small_and_fetches_nothing(page: str) -> None:
    assert len(page.encode()) < LARGEST
    for tag, attributes in read(page).elements:
        for name in ("src", "href", "action", "poster", "srcset"):
            value = attributes.get(name)
            assert value is None or value.startswith(("data:", "#")), (tag, name, value)
        assert not any(name.startswith("on") or name == "style" for name in attributes), tag


def test_long_movies_are_thinned_in_the_map_alone(tissue_analysis: Analysis) -> None:
    grid = tissue_analysis.grid
    many = replace(tissue_analysis, grid=replace(grid, displacement_px=np.tile(grid.displacement_px, (200, 1, 1))))
    found = displacement(many)
    assert found is not None
    assert found["every"] > 1
    assert len(found["data"]) < 3_300_000
    assert found["count"] == -(-75 * 200 // found["every"])


def test_large_noisy_pictures_stay_below_the_limit(tissue_analysis: Analysis) -> None:
    from microbundle.report.pictures import data_uri

    noise = np.random.default_rng(0).integers(0, 255, (2048, 2048)).astype(np.uint8)
    assert len(data_uri(noise)) < 3_000_000
    assert data_uri(np.zeros((16, 16), np.uint8)).startswith("data:image/png")
    assert len(tissue_analysis.image) == 128


def test_only_the_page_s_own_scripts_and_styles_may_run(page: str) -> None:
    found = read(page)
    policy = next(a["content"] for tag, a in found.elements if a.get("http-equiv") == "Content-Security-Policy")
    assert policy is not None
    assert policy.startswith("default-src 'none'")
    assert "unsafe" not in policy
    for kind in ("module", "style"):
        digest = base64.b64encode(hashlib.sha256(found.kept[kind].encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy
    assert [a.get("type") for tag, a in found.elements if tag == "script"] == ["application/json", "module"]


def test_hostile_names_are_text(tissue_analysis: Analysis) -> None:
    strain = tissue_analysis.strain
    assert strain is not None
    hostile = replace(
        tissue_analysis, name=HOSTILE, files=(f"/a/{HOSTILE}.tif",), movie_findings=(Finding("x", "review", HOSTILE),),
        versions={HOSTILE: HOSTILE}, strain=replace(strain, reason=(HOSTILE, *strain.reason[1:])))
    page = report_page(hostile)
    found = read(page)
    assert [a.get("type") for tag, a in found.elements if tag == "script"] == ["application/json", "module"]
    assert not [a for tag, a in found.elements if tag == "img"]
    assert data_of(page)["name"] == HOSTILE
    assert found.text.count(HOSTILE) >= 3
    assert "/a/" not in found.text


def test_embedded_json_holds_no_end_of_a_script() -> None:
    text = embedded({"a": HOSTILE, "b": "<!--"})
    assert not set("<>&\u2028") & set(text)
    assert json.loads(text) == {"a": HOSTILE, "b": "<!--"}


@pytest.mark.parametrize(("value", "error", "expected"), [
    (5.2581, 0.0137, "5.258 ± 0.014"), (-0.0219, 0.00031, "−0.02190 ± 0.00031"), (3.0, float("nan"), "3.000"),
    (float("nan"), 1.0, "–"), (1234.5, 120.0, "1234 ± 120"), (0.0, 0.0, "0")])
def test_values_are_written_to_the_digits_of_their_error(value: float, error: float, expected: str) -> None:
    assert with_error(value, error) == expected


def test_rounding_keeps_shape_and_what_is_missing() -> None:
    assert rounded(np.array([[1.23456, np.nan], [0.0, -2e-9]])) == [[1.235, None], [0.0, -2e-9]]
    assert rounded(np.zeros((0, 3))) == []


# --- results that lack something --------------------------------------------------------------------------------------


def without_beats(analysis: Analysis) -> Analysis:
    beats = analysis.beats
    fail = Finding("no_measurable_motion", "fail", "Nothing moves by more than noise.")
    none = replace(beats, start=beats.start[:0], peak=beats.peak[:0], stop=beats.stop[:0], complete=beats.complete[:0],
                   left_out=beats.left_out[:0],
                   beat_relaxed_px=beats.beat_relaxed_px[:0], findings=(fail,))
    return replace(analysis, beats=none)


def test_without_pillars_the_page_says_why(tissue_analysis: Analysis, made: Tables, page: str) -> None:
    found = read(page)
    assert found.text.count("No pillars") >= 1
    left_out = replace(tissue_analysis, config=Config.from_dict({"pillars": {"masks": "none"}}))
    assert "Pillars were left out" in read(report_page(left_out, made)).text
    assert data_of(page)["loop"] is None


def test_without_strain_the_page_says_why(tissue_analysis: Analysis) -> None:
    why = Finding("no_strain", "review", "No sub-domain fits: the tissue is too small.")
    page = report_page(replace(tissue_analysis, strain=None, movie_findings=(why,)))
    assert f"No strain. {why.message}" in read(page).text
    assert data_of(page)["strain"] is None


def test_without_beats_the_page_says_why(tissue_analysis: Analysis) -> None:
    page = report_page(with_pillars(without_beats(tissue_analysis)))
    found = read(page)
    assert found.text.count("Nothing moves by more than noise.") >= 4
    assert "No beat was found above the movie's detection limit." in found.text
    assert data_of(page)["beats"] == []


def test_without_calibration_units_are_px_and_frames(tissue_analysis: Analysis) -> None:
    bare = replace(tissue_analysis, um_per_px=None, um_per_px_source="unknown", time_s=None, time_source="unknown")
    page = report_page(bare)
    data, found = data_of(page), read(page)
    assert (data["length_unit"], data["time_unit"]) == ("px", "frames")
    assert data["signals"][0]["unit"] == "px"
    assert "µm" not in found.text
    assert "unknown pixel size" in found.text


@pytest.mark.parametrize("method", ["fast", "paper"])
def test_methods_without_errors_have_a_page(tissue_analysis: Analysis, method: str) -> None:
    config = Config.from_dict({"method": method})
    page = report_page(replace(tissue_analysis, config=config, tracks=replace(tissue_analysis.tracks, field=None)))
    assert data_of(page)["signals"][0]["lines"][0]["se"] is None
    assert "gives no standard errors" in read(page).text


def test_what_is_nan_everywhere_has_a_page(tissue_analysis: Analysis) -> None:
    grid = replace(tissue_analysis.grid, displacement_px=np.full_like(tissue_analysis.grid.displacement_px, np.nan))
    assert data_of(report_page(replace(tissue_analysis, grid=grid)))["map"] is None


# --- files ------------------------------------------------------------------------------------------------------------


def test_the_result_file_alone_gives_the_same_bytes(tissue_analysis: Analysis, tmp_path: Path) -> None:
    analysis = with_pillars(tissue_analysis, noise_px=0.01)
    made = tables(analysis)
    folder = save(analysis, tmp_path / "r", made=made, extra=lambda into: with_report(analysis, made, into))
    before = (folder / NAME).read_bytes()
    assert cli.run(["report", str(folder), "--out", str(tmp_path / "again.html"), "--quiet"]) == 0
    assert (tmp_path / "again.html").read_bytes() == before
    assert cli.run(["report", str(folder / RESULT), "--overwrite", "--quiet"]) == 0
    assert (folder / NAME).read_bytes() == before
    assert load(folder).name == analysis.name


@pytest.mark.parametrize("flags", [[], ["--no-report"]])
def test_analyze_writes_a_report_unless_it_is_left_out(tissue_analysis: Analysis, monkeypatch: pytest.MonkeyPatch,
                                                       tissue_folder: Path, tmp_path: Path, flags: list[str]) -> None:
    monkeypatch.setattr(pipeline, "analyze", lambda *_, **__: tissue_analysis)
    out = tmp_path / "out"
    assert cli.run(["analyze", str(tissue_folder), "--out", str(out), "--quiet", *flags]) == 0
    assert (out / NAME).is_file() == (not flags)


def test_a_report_comes_into_a_result_folder_as_one_of_its_files(tissue_analysis: Analysis, made: Tables,
                                                                 tmp_path: Path) -> None:
    folder = save(tissue_analysis, tmp_path / "r", made=made)
    assert cli.run(["report", str(folder), "--quiet"]) == 0
    assert NAME in json.loads((folder / "microbundle.json").read_text())["files"]
    check_free(folder, KIND, overwrite=True)


def test_a_report_replaces_only_a_report_and_only_when_asked(tissue_analysis: Analysis, made: Tables,
                                                             tmp_path: Path) -> None:
    file = write_report(tissue_analysis, tmp_path / "r.html", made=made)
    before = file.read_bytes()
    with pytest.raises(OutputError, match="exists already"):
        write_report(tissue_analysis, file, made=made)
    assert write_report(tissue_analysis, file, made=made, overwrite=True).read_bytes() == before
    notes = tmp_path / "notes.html"
    notes.write_text("<p>mine</p>")
    with pytest.raises(OutputError, match="never replaced"):
        write_report(tissue_analysis, notes, made=made, overwrite=True)
    assert notes.read_text() == "<p>mine</p>"
    assert sorted(f.name for f in tmp_path.iterdir()) == ["notes.html", "r.html"]


def test_a_folder_in_the_way_is_one_sentence(tissue_analysis: Analysis, made: Tables, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="folder of that name"):
        write_report(tissue_analysis, tmp_path, made=made, overwrite=True)


def test_a_movie_is_shown_where_it_is_small(tissue_analysis: Analysis, made: Tables, tmp_path: Path) -> None:
    movie = tmp_path / "a <b>.mp4"
    movie.write_bytes(b"\0" * 100)
    found = read(report_page(tissue_analysis, made, movie))
    assert "data:video/mp4;base64,AAAA" in str(next(a["src"] for tag, a in found.elements if tag == "video"))
    movie.write_bytes(b"\0" * 5_000_000)
    found = read(report_page(tissue_analysis, made, movie))
    assert "too large for this page (5.0 MB)" in found.text
    assert not [a for tag, a in found.elements if tag == "video"]
    with pytest.raises(OutputError, match="cannot be read"):
        report_page(tissue_analysis, made, tmp_path / "none.mp4")


# --- the index --------------------------------------------------------------------------------------------------------


def test_the_index_lists_movies_with_relative_links(tissue_analysis: Analysis, made: Tables, tmp_path: Path) -> None:
    folder = save(tissue_analysis, tmp_path / "plate 1" / "well #A1",
                  extra=lambda into: with_report(tissue_analysis, made, into), made=made)
    bad = without_beats(replace(tissue_analysis, name=HOSTILE))
    page = write_index([folder, summarize(bad, tables(bad)["summary"])], tmp_path / "index.html").read_text("utf-8")
    found = read(page)
    links = [a["href"] for tag, a in found.elements if tag == "a"]
    assert links == ["plate%201/well%20%23A1/report.html"]
    assert "2 movies" in found.text
    assert "1 fail" in found.text
    assert HOSTILE in found.text
    assert "Nothing moves by more than noise." in found.text
    assert number(made["summary"].set_index("metric").loc["amplitude_um", "mean"]) in found.text
    assert len([a for tag, a in found.elements if tag == "img"]) == 2
    assert [a.get("type") for tag, a in found.elements if tag == "script"] == ["application/json", "module"]


def test_an_index_over_nothing_or_over_other_folders_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="at least one"):
        write_index([], tmp_path / "index.html")
    with pytest.raises(ResultUnreadable):
        write_index([tmp_path], tmp_path / "index.html")
    assert not (tmp_path / "index.html").exists()
