"""A comparison of what `microbundle batch` really writes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

import microbundle
from microbundle.batch.plan import make_plan
from microbundle.batch.run import run_batch
from microbundle.config import Config


def test_a_run_of_movies_is_compared(tissue_array: NDArray[Any], tmp_path: Path) -> None:
    """Two wells of each group on one plate; every other frame beats twice as fast."""
    rng = np.random.default_rng(0)
    lines = ["movie,group,well,plate"]
    for i, (group, fps_share) in enumerate((("control", 1), ("fast", 2), ("control", 1), ("fast", 2), ("control", 1))):
        frames = tissue_array[:40 * fps_share:fps_share, 20:108]
        noisy = np.clip(frames + rng.normal(0, 200, frames.shape), 0, 65535).astype("u2") if i < 4 else frames[:1]
        tifffile.imwrite(tmp_path / f"m{i}.tif", noisy)
        lines.append(f"m{i}.tif,{group},A{i},P1")
    (tmp_path / "plate.csv").write_text("\n".join(lines))
    plan = make_plan(tmp_path / "plate.csv", config=Config(method="fast", fps=30, um_per_px=4), report=False)
    outcome = run_batch(plan, tmp_path / "run", workers=1)
    found = microbundle.compare(outcome.out, metrics=["amplitude_um", "cd50_s"])
    table = found.tables["comparison"].set_index(["metric", "group"])
    assert table.loc[("cd50_s", "fast"), "ratio"] == pytest.approx(0.5, abs=0.08)
    assert table.loc[("cd50_s", "fast"), "unit"] == "well"
    assert table.loc[("amplitude_um", "control"), "n_wells"] == 2
    assert found.tables["left_out"]["movie_or_well"].tolist() == ["m4.tif"]
    assert "amplitude_um" in microbundle.compare(outcome.out).run.metrics
    written = outcome.out / "comparison"
    assert written in outcome.files
    kept = (written / "comparison.csv").read_bytes()
    (written / "mine.txt").write_text("of the user")

    (tmp_path / "plate.csv").write_text("\n".join(",".join(line.split(",")[::2]) for line in lines))  # no groups
    plan = make_plan(tmp_path / "plate.csv", config=Config(method="fast", fps=30, um_per_px=4), report=False)
    again = run_batch(plan, outcome.out, workers=1)
    assert again.unchanged == 5
    assert (written / "comparison.csv").read_bytes() == kept
    assert any("is of an earlier run" in note for note in again.notes)
    (written / "mine.txt").unlink()
    assert not any("comparison" in note for note in run_batch(plan, outcome.out, workers=1).notes)
    assert not written.exists()
