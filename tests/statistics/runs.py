"""Folders as `microbundle batch` writes them, with chosen numbers: what the comparison reads, without movies."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

STATISTICS = ("n", "mean", "se", "sd", "low_95", "high_95")


def write_run(folder: Path, rows: Sequence[Mapping[str, Any]], metrics: Sequence[str] = ("amplitude_um",)) -> Path:
    """Write the two tables of a run; a row is a movie: its columns, its metrics, and `state`, `verdict` where they are
    not done and pass."""
    folder.mkdir(parents=True, exist_ok=True)
    about = ("movie", "state", "verdict", *metrics)
    columns = list(dict.fromkeys(name for row in rows for name in row if name not in about))
    with (folder / "movies.csv").open("w", newline="") as movies, (folder / "plate.csv").open("w", newline="") as plate:
        every, tidy = csv.writer(movies, lineterminator="\n"), csv.writer(plate, lineterminator="\n")
        every.writerow(["movie", *columns, "state", "verdict", "failure_kind", "failure", "beats", *metrics, "result"])
        tidy.writerow(["movie", *columns, "metric", *STATISTICS, "verdict"])
        for i, row in enumerate(rows):
            name, state = str(row.get("movie", f"m{i}.tif")), row.get("state", "done")
            verdict = row.get("verdict", "pass" if state == "done" else "")
            known = [str(row.get(column, "")) for column in columns]
            values = [repr(float(row[metric])) if metric in row else "" for metric in metrics]
            kind = "" if state == "done" else "NoTissue"
            every.writerow([name, *known, state, verdict, kind, "", "9", *values, f"results/{name}"])
            if state == "done":
                for metric, value in zip(metrics, values, strict=True):
                    tidy.writerow([name, *known, metric, "9", value, "", "", "", "", verdict])
    return folder
