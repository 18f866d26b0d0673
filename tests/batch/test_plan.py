"""Which movies are planned, and what is known of each before it is opened."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from microbundle import cli
from microbundle.batch.manifest import read_manifest
from microbundle.batch.names import Pattern
from microbundle.batch.plan import make_plan
from microbundle.config import Config
from microbundle.errors import ConfigError, MovieUnreadable

Image = NDArray[Any]
Captured = pytest.CaptureFixture[str]
SETTINGS = Config(method="fast", fps=30, um_per_px=4)


# --- which movies ---------------------------------------------------------------------------------------------------


def test_movies_are_files_layouts_and_folders_of_frames(plate: Path) -> None:
    plan = make_plan(plate)
    assert [task.movie for task in plan.tasks] == ["A1.tif", "A2", "B1.tif", "B2", "C1.tif", "C2.tif"]
    assert [task.path for task in plan.tasks][:2] == [plate / "A1.tif", plate / "A2"]


def test_a_folder_that_is_a_movie_and_a_file_are_planned_by_themselves(plate: Path) -> None:
    assert [task.movie for task in make_plan(plate / "A2").tasks] == ["A2"]
    assert [task.movie for task in make_plan(plate / "A1.tif").tasks] == ["A1.tif"]


def test_results_hidden_files_and_links_back_are_no_movies(plate: Path, tmp_path: Path) -> None:
    (tmp_path / "movies" / "old").mkdir(parents=True)
    (tmp_path / "movies" / "A1.tif").symlink_to(plate / "A1.tif")
    (tmp_path / "movies" / "._A1.tif").touch()
    (tmp_path / "movies" / "old" / "x.tif").touch()
    (tmp_path / "movies" / "old" / "microbundle.json").write_text('{"kind": "results"}')
    (tmp_path / "movies" / "again").symlink_to(tmp_path / "movies")
    assert [task.movie for task in make_plan(tmp_path / "movies").tasks] == ["A1.tif"]


@pytest.mark.parametrize(("imagej", "bigtiff"), [(True, False), (False, True), (False, False)])
def test_several_stacks_in_one_folder_are_a_movie_each(tmp_path: Path, imagej: bool, bigtiff: bool) -> None:
    for n in (2, 10):
        tifffile.imwrite(tmp_path / f"{n}.tif", np.zeros((5, 8, 8), "u1"), imagej=imagej, bigtiff=bigtiff)
    (tmp_path / "1.tif").touch()
    assert [task.movie for task in make_plan(tmp_path).tasks] == ["1.tif", "2.tif", "10.tif"]


def test_a_source_without_movies_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="expected movies"):
        make_plan(tmp_path)
    with pytest.raises(MovieUnreadable, match="there is no such file"):
        make_plan(tmp_path / "nothing")


def test_result_folders_have_safe_names_of_one_movie_each(tmp_path: Path) -> None:
    names = ["a/b.tif", "a__b.tif", "ä b.tif", "ä_b.tif", "X.tif", "x.tif", "-c.tif", "long" * 30 + ".tif"]
    manifest = tmp_path / "m.csv"
    manifest.write_text("movie\n" + "\n".join(names) + "\n", encoding="utf-8")
    keys = [task.key for task in make_plan(manifest).tasks]
    assert keys[0] == "a__b.tif"
    assert len({key.casefold() for key in keys}) == len(names)
    assert all(key.isascii() and len(key) <= 100 and key[0] not in ".-" for key in keys)


# --- what is known of them ------------------------------------------------------------------------------------------


def test_a_manifest_gives_settings_and_columns(tmp_path: Path) -> None:
    manifest = tmp_path / "m.csv"
    manifest.write_text("\ufeffMovie;FPS;um_per_px;stiffness;depth;pacing;drug;plate\r\n"
                        "a.tif;30;4;2.7;100;1;\"iso;1 uM\";P1\r\n\r\nb.tif;;;;;;;P2\r\n", encoding="utf-8")
    plan = make_plan(manifest, config=Config(fps=20))
    assert plan.columns == ("plate", "fps", "um_per_px", "stiffness_un_per_um", "depth_um", "pacing_hz", "drug")
    first, second = plan.tasks
    assert (first.path, first.columns["drug"]) == (tmp_path / "a.tif", "iso;1 uM")
    assert (first.config.fps, first.config.pillars.depth_um, first.config.metrics.pacing_hz) == (30, 100, 1)
    assert first.config.pillars.stiffness_un_per_um == 2.7
    assert second.config == Config(fps=20)


@pytest.mark.parametrize(("text", "told"), [
    ("", "row 1: expected a header with the column movie; found nothing"),
    ("file,fps\na,1\n", "row 1: expected a header with the column movie; found file, fps"),
    ("movie,fps\na,30\nb,fast\n", "row 3, column fps: expected a positive number; found 'fast'"),
    ("movie,um_per_px\na,-4\n", "row 2, column um_per_px: expected a positive number; found '-4'"),
    ("movie,stiffness\na,nan\n", "row 2, column stiffness_un_per_um: expected a positive number; found 'nan'"),
    ("movie,plate\n,P1\n", "row 2, column movie: expected the path of a movie; the cell is empty"),
    ("movie\na\n\na\n", "row 4, column movie: expected each movie once; a is in row 2 already"),
    ("movie,plate\na,P1,x\n", "row 2: expected at most 2 cells, as in the header; found 3"),
    ("movie,fps,fps\na,1,2\n", "column fps: expected each column once"),
    ("movie,verdict\na,good\n", "column verdict: the tables of the results have a column of that name"),
    ("movie,,x\na,1,2\n", "that of column 2 is empty"),
    ("movie,plate\n", "expected a row for each movie"),
    ('movie,plate\na,"P1\n', "expected cells in CSV"),
])
def test_a_wrong_manifest_is_refused_with_row_and_column(tmp_path: Path, text: str, told: str) -> None:
    manifest = tmp_path / "m.csv"
    manifest.write_text(text)
    with pytest.raises(ConfigError) as error:
        read_manifest(manifest)
    assert told in str(error.value)
    assert str(manifest) in str(error.value)


def test_all_faults_of_a_manifest_are_told_at_once_and_the_exit_code_is_2(tmp_path: Path, capsys: Captured) -> None:
    manifest = tmp_path / "m.csv"
    manifest.write_text("movie,fps\n" + "".join(f"m{i},bad\n" for i in range(30)))
    assert cli.run(["batch", str(manifest), "--out", str(tmp_path / "out")]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("column fps")) == ("", 10)
    assert "and 20 more like these" in err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("pattern", "movie", "found"), [
    ("{plate}_{well}", "x/P_1_A01.ome.tif", {"plate": "P_1", "well": "A01"}),
    ("{plate}/d{day}/{well}*", "x/P1/d14/B2_cam.tif", {"plate": "P1", "day": "14", "well": "B2"}),
    ("{group}", "drug 1.5 uM", {"group": "drug 1.5 uM"}),
    (r"(?P<plate>P\d)-(?P<well>\w\d)(?:-(?P<day>\d+))?", "P1-A1.tif", {"plate": "P1", "well": "A1", "day": ""}),
    ("{plate}_{well}", "A01.tif", {}),
])
def test_a_pattern_reads_columns_from_names(pattern: str, movie: str, found: dict[str, str]) -> None:
    assert Pattern(pattern).read(movie) == found


@pytest.mark.parametrize("pattern", ["plate", "{plate", "{a b}", "(?P<x>", "{plate}_{plate}"])
def test_a_wrong_pattern_is_refused(pattern: str) -> None:
    with pytest.raises(ConfigError, match="--pattern"):
        Pattern(pattern)


def test_names_that_a_pattern_does_not_fit_are_told(plate: Path) -> None:
    plan = make_plan(plate, pattern="{group}2")
    assert [task.columns.get("group", "") for task in plan.tasks] == ["", "A", "", "B", "", "C"]
    assert "does not fit 3 of 6 names, such as A1.tif" in plan.notes[0]
    with pytest.raises(ConfigError, match=r"it fits none of them, such as A1\.tif"):
        make_plan(plate, pattern="{plate}_{well}")
    with pytest.raises(ConfigError, match="expected a positive number; found 'A1'"):
        make_plan(plate, pattern="{fps}")
