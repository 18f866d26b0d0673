"""Pictures of a run share their limits, and are drawn again where, and only where, something changed."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from microbundle import folder
from microbundle.batch.limits import read_limits, robust, shared_limits
from microbundle.batch.plan import make_plan
from microbundle.batch.run import run_batch
from microbundle.config import Config
from microbundle.errors import OutputError
from microbundle.events import BatchEvent, Drawing, Drawn
from microbundle.folder import LIST, check_free, write_within

Image = NDArray[Any]
SETTINGS = Config.from_dict({"method": "fast", "fps": 30, "um_per_px": 4, "strain": {"tile_px": 20}})


@pytest.fixture(scope="module")
def two(small: Image, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A movie, and one of noise, which fails."""
    home = tmp_path_factory.mktemp("two")
    tifffile.imwrite(home / "A1.tif", small)
    rng = np.random.default_rng(1)
    tifffile.imwrite(home / "B1.tif", np.clip(small[:1] + rng.normal(0, 250, small.shape), 0, 65535).astype("u2"))
    return home


def listed(result: Path) -> set[str]:
    return set(json.loads((result / LIST).read_text())["files"]) | {LIST}


def found(result: Path) -> set[str]:
    return {file.relative_to(result).as_posix() for file in result.rglob("*") if file.is_file()}


def test_pictures_are_drawn_with_shared_limits_and_again_only_where_those_change(two: Path, tmp_path: Path) -> None:
    out, told = tmp_path / "out", list[BatchEvent]()

    def drawn(**wanted: bool) -> list[str]:
        told.clear()
        outcome = run_batch(make_plan(two, config=SETTINGS, report=False, **wanted), out, workers=1, tell=told.append)
        assert not outcome.undrawn
        return [event.movie for event in told if isinstance(event, Drawn)]

    assert drawn(movies=True) == ["A1.tif", "B1.tif"]
    result, failed = out / "results" / "A1.tif", out / "results" / "B1.tif"
    own = read_limits(result)
    assert own is not None
    assert used(result) == {name: list(limits) for name, limits in own["movies"].items()}, "B1 fails"
    assert used(failed).items() <= used(result).items()
    assert set(os.listdir(result / "movies")) == {"displacement.mp4", "strain.mp4", "limits.json"}
    assert found(result) == listed(result)
    before = (result / "result.nc").stat().st_mtime_ns
    assert drawn(movies=True) == []
    assert Drawing(2, 2) in told

    wider = {name: (low * 2, high * 2) for name, (low, high) in own["movies"].items()}
    (result / "limits.json").write_text(json.dumps(own | {"movies": wider}))
    assert drawn(movies=True) == ["A1.tif", "B1.tif"]
    assert used(failed)["displacement"][1] == 2 * own["movies"]["displacement"][1]
    assert (result / "result.nc").stat().st_mtime_ns == before, "nothing is measured again for pictures"
    check_free(result, "results", overwrite=True)
    assert [name for name in os.listdir(out / "results") if name.startswith(".")] == []


def used(result: Path) -> dict[str, list[float]]:
    """Limits that the movies of a result were drawn with."""
    return dict(json.loads((result / "movies" / "limits.json").read_text()))


def test_pictures_of_an_earlier_run_that_cannot_be_drawn_are_told_and_tried_again(two: Path, tmp_path: Path) -> None:
    manifest, out = two / "one.csv", tmp_path / "out"
    manifest.write_text("movie\nA1.tif\n")
    plan = make_plan(manifest, config=SETTINGS, report=False)
    run_batch(plan, out, workers=1)
    result = out / "results" / "A1.tif"
    assert read_limits(result) is None
    whole = (result / "result.nc").read_bytes()
    (result / "result.nc").write_bytes(whole[:1000])
    outcome = run_batch(replace(plan, figures=True), out, workers=1)
    assert "the result cannot be read" in outcome.undrawn["A1.tif"]
    (result / "result.nc").write_bytes(whole)
    assert not run_batch(replace(plan, figures=True), out, workers=1).undrawn
    assert (result / "figures" / "displacement.png").stat().st_size > 5000
    assert read_limits(result) is not None
    assert found(result) == listed(result)


# --- limits ---------------------------------------------------------------------------------------------------------


def test_rare_movies_do_not_flatten_the_others() -> None:
    assert robust([(0.0, 10.0), (0.0, 12.0), (0.0, 20.0)]) == (0.0, 20.0)
    assert robust([(0.0, 10.0), (0.0, 12.0), (0.0, 200.0)]) == (0.0, 12.0)
    assert robust([(-1.0, 3.0), (-2.0, 1.0)]) == (-2.0, 3.0)
    assert robust([(0.0, 200.0)]) == (0.0, 200.0)
    many = [(0.0, float(n)) for n in range(100, 200)]
    assert robust(many) == (0.0, 195.0)


def test_limits_are_shared_by_movies_of_one_unit_and_failed_ones_follow() -> None:
    def own(top: float, unit: str = "µm") -> dict[str, Any]:
        return {"units": [unit, "s"], "figures": {"signal": (0.0, top)}, "movies": {}}

    shared = shared_limits({"a": own(1), "b": own(2), "bad": own(4), "px": own(7, "px")},
                           {"a": "pass", "b": "review", "bad": "fail", "px": "fail"})
    assert {movie: limits["figures"]["signal"][1] for movie, limits in shared.items()} == {
        "a": 2, "b": 2, "bad": 2, "px": 7}


# --- a folder within a result ---------------------------------------------------------------------------------------


def test_a_folder_is_put_whole_into_one_of_ours_and_listed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ours = folder.write_whole(tmp_path / "r", "results", lambda into: (into / "a.csv").write_text("a") and None)

    def pictures(*names: str) -> Any:
        def write(into: Path) -> None:
            into.mkdir()
            for name in names:
                (into / name).write_text(name)
        return write

    write_within(ours, "figures", pictures("1.png", "2.png"))
    write_within(ours, "figures", pictures("3.png"))
    assert found(ours) == listed(ours) == {"a.csv", "figures/3.png", LIST}

    def fails(into: Path) -> None:
        into.mkdir()
        raise OSError(28, "No space left on device")

    with pytest.raises(OutputError, match="No space left"):
        write_within(ours, "figures", fails)
    assert found(ours) == listed(ours) == {"a.csv", "figures/3.png", LIST}
    monkeypatch.setattr(folder, "_write_list", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        write_within(ours, "figures", pictures("4.png"))
    assert found(ours) == listed(ours)
    assert os.listdir(tmp_path) == ["r"]
    (tmp_path / "foreign").mkdir()
    with pytest.raises(OutputError, match="expected a folder with its list of files"):
        write_within(tmp_path / "foreign", "figures", pictures("1.png"))
