"""Results: the same after a round trip, readable by others, written whole or not at all, and never over other files."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
import xarray as xr

from microbundle.analysis import Analysis
from microbundle.config import Config
from microbundle.data import Movie
from microbundle.errors import OutputError, ResultUnreadable
from microbundle.folder import check_free, write_whole
from microbundle.metrics import tables
from microbundle.paper_layout import export_paper
from microbundle.pipeline import analyze
from microbundle.store import load, save


def assert_same(one: Any, other: Any, where: str = "") -> None:
    """Compare two results field by field, arrays with their number types."""
    if is_dataclass(one) and not isinstance(one, type):
        assert type(one) is type(other), where
        for f in fields(one):
            assert_same(getattr(one, f.name), getattr(other, f.name), f"{where}.{f.name}")
    elif isinstance(one, np.ndarray):
        np.testing.assert_array_equal(one, other, err_msg=where)
        assert one.dtype == other.dtype, where
    elif isinstance(one, float) and one != one:
        assert other != other, where
    else:
        assert one == other, where


def everything_in(folder: Path) -> dict[str, bytes]:
    return {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}


def still(count: int = 20) -> Movie:
    """A tissue in which nothing moves, to the last count."""
    rng = np.random.default_rng(0)
    frame = np.full((96, 160), 40000.0)
    frame[30:66, 20:140] = 15000 + 4000 * rng.normal(size=(36, 120))
    frame = np.clip(frame, 0, 65535).astype(np.uint16)
    return Movie.from_array(np.stack([frame] * count), name="still", tissue_mask=frame < 30000)


@pytest.fixture(scope="module")
def saved(tissue_analysis: Analysis, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result folder that tests read or copy."""
    return save(tissue_analysis, tmp_path_factory.mktemp("saved") / "r")


@pytest.fixture
def result(saved: Path, tmp_path: Path) -> Path:
    """A result folder `r`, alone in the test's own folder."""
    return Path(shutil.copytree(saved, tmp_path / "r"))


# --- the same after a round trip ------------------------------------------------------------------------------------


def test_a_result_comes_back_the_same(tissue_analysis: Analysis, saved: Path) -> None:
    folder = saved
    for path in (folder, folder / "result.nc", str(folder)):
        assert_same(tissue_analysis, load(path))
    found = load(folder)
    assert found.verdict == tissue_analysis.verdict
    for name, table in tables(tissue_analysis).items():
        pd.testing.assert_frame_equal(tables(found)[name], table)


def test_findings_settings_files_and_unknowns_come_back(tissue_analysis: Analysis, tmp_path: Path) -> None:
    config = Config.from_dict({"method": "paper", "strain": {"tiles": [2, 2]}, "reading": {"kernel": [[1]]}})
    changed = replace(
        tissue_analysis, config=config, name="Gewebe µ 1", time_s=None, time_source="unknown", um_per_px=None,
        um_per_px_source="unknown", strain=None, files=tuple(f"/a/{'long ' * 30}/frame {i}.tif" for i in range(2000)),
        beats=replace(tissue_analysis.beats, noise_px=float("nan")),
        stage_px=np.linspace(0, 1, 2 * tissue_analysis.frame_count).reshape(-1, 2),
        tracks=replace(tissue_analysis.tracks, forward_backward_px=None))
    assert_same(changed, load(save(changed, tmp_path / "r")))


def test_a_result_without_beats_comes_back(tmp_path: Path) -> None:
    result = analyze(still())
    assert result.verdict == "fail"
    assert len(result.beats) == 0
    folder = save(result, tmp_path / "r")
    assert_same(result, load(folder))


@pytest.mark.filterwarnings("error")
def test_plain_xarray_opens_it_with_units(saved: Path) -> None:
    with xr.open_dataset(saved / "result.nc") as data:
        for name, variable in data.data_vars.items():
            assert "units" in variable.attrs, name
            assert variable.attrs["long_name"], name
        assert data["position"].attrs["units"] == "px"
        assert data["time"].attrs["units"] == "s"
        assert list(data["axis"].values) == ["row", "col"]
        assert data["E"].sel(i="col", j="col", subdomain="A1").shape == (75,)
        assert json.loads(data.attrs["config"])["strain"]["tile_px"] == 20


def test_the_file_holds_tables_that_xarray_reads_as_they_are(tissue_analysis: Analysis, saved: Path) -> None:
    for name, table in tables(tissue_analysis).items():
        if name in ("summary", "beats", "subdomains"):
            with xr.open_dataset(saved / "result.nc", group=f"tables/{name}") as read:
                found = read.to_dataframe()
            pd.testing.assert_frame_equal(found, table, check_names=False, check_dtype=False, check_column_type=False)


def test_tables_are_plain_csv(tissue_analysis: Analysis, saved: Path) -> None:
    for name, table in tables(tissue_analysis).items():
        if len(table.columns) == 0:  # no pillars here
            assert not (saved / f"{name}.csv").exists()
            continue
        raw = (saved / f"{name}.csv").read_bytes()
        assert b"\r" not in raw
        read = pd.read_csv(saved / f"{name}.csv")
        assert list(read.columns) == list(table.columns)
        assert len(read) == len(table)


@pytest.mark.parametrize("timed", [False, True])
@pytest.mark.parametrize("scaled", [False, True])
def test_no_unit_appears_that_is_not_known(tissue_analysis: Analysis, tmp_path: Path, timed: bool,
                                           scaled: bool) -> None:
    known = replace(tissue_analysis, time_s=tissue_analysis.time_s if timed else None,
                    um_per_px=tissue_analysis.um_per_px if scaled else None)
    folder = save(known, tmp_path / "r")
    columns = {c for name in ("beats", "frames", "subdomains", "strain", "summary")
               for c in pd.read_csv(folder / f"{name}.csv").columns}
    columns |= set(pd.read_csv(folder / "summary.csv")["metric"])
    endings = {c.rpartition("_")[2] for c in columns}
    assert bool(endings & {"um", "um2"}) == scaled
    assert bool(endings & {"s", "hz", "bpm"}) == timed
    with xr.open_dataset(folder / "result.nc") as data:
        assert ("um_per_px" in data.attrs) == scaled
        assert ("time" in data) == timed


# --- whole or not at all --------------------------------------------------------------------------------------------


def no_space(*_: Any, **__: Any) -> None:
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize("where", [(xr.Dataset, "to_netcdf"), (pd.DataFrame, "to_csv"), (Path, "rename"),
                                   (Path, "write_text")])
@pytest.mark.parametrize("older", [False, True])
def test_a_failure_on_the_way_leaves_nothing(tissue_analysis: Analysis, saved: Path, tmp_path: Path, older: bool,
                                             where: tuple[type, str], monkeypatch: pytest.MonkeyPatch) -> None:
    if older:
        shutil.copytree(saved, tmp_path / "r")
    before = everything_in(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(*where, no_space)
        with pytest.raises(OutputError, match=r"/r: the folder cannot be written: No space left on device$"):
            save(tissue_analysis, tmp_path / "r", overwrite=older)
    assert everything_in(tmp_path) == before
    assert [p.name for p in tmp_path.iterdir()] == (["r"] if older else [])


@pytest.mark.parametrize("kind", [KeyboardInterrupt, RuntimeError])
def test_an_interruption_leaves_nothing(tissue_analysis: Analysis, tmp_path: Path, kind: type[BaseException]) -> None:
    def stop(_: Path) -> None:
        raise kind

    with pytest.raises(kind):
        save(tissue_analysis, tmp_path / "r", extra=stop)
    assert list(tmp_path.iterdir()) == []


def test_the_older_folder_comes_back_when_the_swap_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_whole(tmp_path / "r", "tests", fill)
    before = everything_in(tmp_path)
    real = Path.rename

    def fails_once_filled(self: Path, target: Path) -> Path:
        if self.name.startswith(".r.partial"):
            no_space()
        return real(self, target)

    monkeypatch.setattr(Path, "rename", fails_once_filled)
    with pytest.raises(OutputError):
        write_whole(tmp_path / "r", "tests", fill, overwrite=True)
    assert everything_in(tmp_path) == before


def test_a_place_that_cannot_be_made_is_reported(tissue_analysis: Analysis, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match=r"the folder cannot be written: (Not a directory|File exists)"):
        save(tissue_analysis, tmp_path / "file" / "r")
    with pytest.raises(OutputError, match="expected a folder for the results; there is a file of that name"):
        save(tissue_analysis, tmp_path / "file")
    with pytest.raises(OutputError, match="File name too long"):
        save(tissue_analysis, tmp_path / ("x" * 300))


def test_missing_folders_above_are_made(tmp_path: Path) -> None:
    assert write_whole(tmp_path / "a" / "b", "tests", fill) == tmp_path / "a" / "b"


# --- nothing foreign is replaced ------------------------------------------------------------------------------------


def fill(folder: Path) -> None:
    (folder / "sub").mkdir()
    (folder / "sub" / "one.txt").write_text("1")


def test_an_empty_folder_is_used(tmp_path: Path) -> None:
    (tmp_path / "r").mkdir()
    write_whole(tmp_path / "r", "tests", fill)
    assert (tmp_path / "r" / "sub" / "one.txt").read_text() == "1"
    assert [p.name for p in tmp_path.iterdir()] == ["r"]


def test_an_older_result_is_replaced_only_when_asked(tissue_analysis: Analysis, result: Path, tmp_path: Path) -> None:
    folder, before = result, everything_in(result)
    renamed = replace(tissue_analysis, name="newer")
    with pytest.raises(OutputError, match=r"holds results already\. Replace them with --overwrite"):
        save(renamed, folder)
    assert everything_in(folder) == before
    (folder / ".DS_Store").write_text("left by the system")
    save(renamed, folder, overwrite=True)
    assert load(folder).name == "newer"
    assert everything_in(folder).keys() == before.keys()
    assert [p.name for p in tmp_path.iterdir()] == ["r"]


def add_notes(folder: Path) -> None:
    (folder / "notes.txt").write_text("mine")


def add_deep(folder: Path) -> None:
    (folder / "sub" / "deep").mkdir(parents=True)
    (folder / "sub" / "deep" / "mine.txt").write_text("mine")


def add_link(folder: Path) -> None:
    (folder / "link").symlink_to(folder.parent)


def add_folder(folder: Path) -> None:
    (folder / "mine").mkdir()


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("add", [add_notes, add_deep, add_link, add_folder])
@pytest.mark.parametrize("ours", [False, True])
def test_a_folder_with_foreign_files_is_never_touched(tmp_path: Path, overwrite: bool, add: Callable[[Path], None],
                                                      ours: bool) -> None:
    folder = tmp_path / "r"
    if ours:
        write_whole(folder, "tests", fill)
    else:
        folder.mkdir()
    add(folder)
    before, names = everything_in(tmp_path), sorted(p.name for p in folder.rglob("*"))
    with pytest.raises(OutputError, match=r"holds something else, such as .*which is never replaced"):
        write_whole(folder, "tests", fill, overwrite=overwrite)
    assert everything_in(tmp_path) == before
    assert sorted(p.name for p in folder.rglob("*")) == names


def test_a_stray_result_file_does_not_make_a_folder_ours(tissue_analysis: Analysis, result: Path,
                                                         tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    (result / "result.nc").rename(tmp_path / "other" / "result.nc")
    with pytest.raises(OutputError, match="never replaced"):
        save(tissue_analysis, tmp_path / "other", overwrite=True)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"kind": "tests"}', '{"kind": "tests", "files": 3}'])
def test_a_spoiled_list_makes_a_folder_foreign(tmp_path: Path, text: str) -> None:
    write_whole(tmp_path / "r", "tests", fill)
    (tmp_path / "r" / "microbundle.json").write_text(text)
    with pytest.raises(OutputError, match="never replaced"):
        check_free(tmp_path / "r", "tests", overwrite=True)


def test_an_export_replaces_an_export_and_no_result(tissue_analysis: Analysis, result: Path, tmp_path: Path) -> None:
    export_paper(tissue_analysis, tmp_path / "e")
    export_paper(tissue_analysis, tmp_path / "e", overwrite=True)
    with pytest.raises(OutputError, match="holds files in the paper's layout already"):
        export_paper(tissue_analysis, tmp_path / "e")
    with pytest.raises(OutputError, match=r"it holds something else \(files in the paper's layout\)"):
        save(tissue_analysis, tmp_path / "e", overwrite=True)
    with pytest.raises(OutputError, match=r"it holds something else \(results\)"):
        export_paper(tissue_analysis, result, overwrite=True)


def test_the_folder_one_works_in_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for place in (".", ".."):
        with pytest.raises(OutputError, match="this is the folder you work in"):
            check_free(place, "tests")
    assert check_free("new", "tests") == tmp_path / "new"


def test_a_link_to_a_folder_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    for overwrite in (False, True):
        assert write_whole(tmp_path / "link", "tests", fill, overwrite=overwrite) == tmp_path / "real"
    assert (tmp_path / "link").is_symlink()


# --- what is no result ----------------------------------------------------------------------------------------------


def test_what_is_no_result_is_refused(tmp_path: Path) -> None:
    (tmp_path / "rubbish.nc").write_bytes(b"rubbish" * 100)
    (tmp_path / "empty.nc").write_bytes(b"")
    xr.Dataset({"a": ("x", [1, 2])}).to_netcdf(tmp_path / "foreign.nc", engine="h5netcdf")
    for name, said in (("rubbish.nc", "cannot be read"), ("empty.nc", "cannot be read"), ("", "expected a microbundle"),
                       ("foreign.nc", "another NetCDF file"), ("nothing", "there is none")):
        with pytest.raises(ResultUnreadable, match=said) as caught:
            load(tmp_path / name)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.99])
def test_a_result_that_was_cut_off_is_refused(result: Path, share: float) -> None:
    file = result / "result.nc"
    os.truncate(file, int(share * file.stat().st_size))
    with pytest.raises(ResultUnreadable, match=r"result\.nc: the result cannot be read"):
        load(result)


@pytest.mark.parametrize("change", [{"config": '{"no": 1}'}, {"findings": "x"}, {"grid_shape": [1, 1]},
                                    {"microbundle_schema": 99}])
def test_a_result_that_was_changed_is_refused(result: Path, change: dict[str, Any]) -> None:
    with h5py.File(result / "result.nc", "a") as file:
        file.attrs.update(change)
    with pytest.raises(ResultUnreadable, match=r"result\.nc: ") as caught:
        load(result)
    assert "\n" not in str(caught.value)
    assert "http" not in str(caught.value)
