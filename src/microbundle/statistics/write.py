"""Write a comparison: its tables, those for Prism, and its figures."""

from __future__ import annotations

from pathlib import Path

from ..folder import write_whole
from .compare import Comparison, compare
from .prism import write_prism

KIND = "results of a comparison"
PRISM, FIGURES = "prism", "figures"


def write_comparison(comparison: Comparison, folder: Path | str, *, figures: bool = True,
                     overwrite: bool = False) -> Path:
    """Write a comparison into a new folder: CSV tables, `prism/`, and `figures/` as PNG and PDF; returns its path.

    Raises OutputError where the folder exists and may not be replaced, or cannot be written; nothing is left then.
    """
    return write_whole(Path(folder), KIND, lambda into: _fill(comparison, into, figures), overwrite=overwrite)


def write_into(run: Path, into: Path, *, only_pass: bool = False, figures: bool = False) -> Comparison:
    """Compare a run by its usual columns, and write the comparison in place of an older one; the same run gives the
    same bytes.

    Whether a run has such columns, `wells.comparable` tells. Raises OutputError where `into` holds anything else or
    cannot be written, ResultUnreadable, and ConfigError for a wrong dose or where nothing can be compared.
    """
    comparison = compare(run, only_pass=only_pass)
    write_comparison(comparison, into, figures=figures, overwrite=True)
    return comparison


def _fill(comparison: Comparison, into: Path, figures: bool) -> None:
    for name, table in comparison.tables.items():
        table.to_csv(into / f"{name}.csv", index=False, float_format="%.7g", lineterminator="\n")
    write_prism(comparison.run, into / PRISM)
    if figures:
        from ..figures_comparison import save_all

        save_all(comparison, into / FIGURES)
