"""Set validations side by side, movie by movie: the tables of docs/validation.md.

    microbundle validate --cases SET --method accurate --out A ; microbundle validate --cases SET --method paper --out P
    python benchmarks/validation_tables.py accurate=A paper=P

A cell is: error of the peak MAD (%) / worst E_cc error (% of its peak) / root mean square error (px).
"""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd


def cell(row: pd.Series) -> str:
    """Three errors, or why there are none."""
    if row["status"] != "measured":
        return str(row["status"])
    if pd.isna(row["mad_error_pct"]):
        return f"{int(row['extra_beats'])} false beats / {row['rmse_px']:.4f} / {row['verdict']}"
    return f"{row['mad_error_pct']:+.2f} / {row['ecc_mae_pct']:.1f} / {row['rmse_px']:.4f}"


def main(arguments: list[str]) -> None:
    runs = {}
    for argument in arguments:
        name, folder = argument.split("=", 1)
        runs[name] = pd.read_csv(Path(folder) / "scores.csv").set_index("case")
    first = next(iter(runs.values()))
    print(f"| movie | peak MAD px | {' | '.join(runs)} |\n|{'---|' * (2 + len(runs))}")
    for case, row in first.iterrows():
        cells = [cell(scores.loc[case]) if case in scores.index else "" for scores in runs.values()]
        size = "" if pd.isna(row["true_mad_px"]) else f"{row['true_mad_px']:.2f}"
        print(f"| {case} | {size} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main(sys.argv[1:])
