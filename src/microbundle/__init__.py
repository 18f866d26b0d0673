"""Displacement, strain and beat metrics from movies of cardiac microbundles.

    import microbundle
    movie = microbundle.read_movie("my_movie", fps=30, um_per_px=4)
    analysis = microbundle.analyze(movie)
    microbundle.tables(analysis)["summary"]
    analysis.displacement_at([[262, 254]])          # (T, 1, 2): row, col, in px
    microbundle.save(analysis, "my_movie_microbundle")
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from . import figures, movies
    from .analysis import Analysis
    from .bodies import follow_body
    from .compat import compat_columns
    from .config import Config
    from .data import Movie
    from .decide import decide
    from .decisions import Decisions, read_decisions, write_decisions
    from .errors import (
        CalibrationMissing,
        CannotMeasure,
        ChoiceMissing,
        ClusterUnusable,
        ConfigError,
        MaskUnusable,
        MicrobundleError,
        MovieUnreadable,
        NoPillars,
        NoTexture,
        NoTissue,
        OutputError,
        ResultUnreadable,
    )
    from .mask_files import read_mask
    from .metrics import tables
    from .paper_layout import export_paper
    from .pipeline import analyze
    from .read import read_movie
    from .report import write_index, write_report
    from .statistics.compare import compare
    from .statistics.write import write_comparison
    from .store import load, save
    from .subsets import follow_points
    from .uncertainty import alternatives, displacement_error_at, standard_errors
    from .workbook import write_workbook

_HOME = {
    "Analysis": "analysis", "Config": "config", "Movie": "data", "analyze": "pipeline", "compare": "statistics.compare",
    "compat_columns": "compat", "decide": "decide", "write_comparison": "statistics.write",
    "export_paper": "paper_layout", "load": "store", "read_mask": "mask_files", "read_movie": "read", "save": "store",
    "tables": "metrics", "write_workbook": "workbook",
    **dict.fromkeys(("Decisions", "read_decisions", "write_decisions"), "decisions"),
    **dict.fromkeys(("write_index", "write_report"), "report"),
    "follow_body": "bodies", "follow_points": "subsets",
    **dict.fromkeys(("alternatives", "displacement_error_at", "standard_errors"), "uncertainty"),
    **dict.fromkeys(("CalibrationMissing", "CannotMeasure", "ChoiceMissing", "ClusterUnusable", "ConfigError",
                     "MaskUnusable", "MicrobundleError", "MovieUnreadable", "NoPillars", "NoTexture", "NoTissue",
                     "OutputError", "ResultUnreadable"), "errors"),
}
"""Module of each public name; they are imported when first used, so that `import microbundle` is fast."""

_MODULES = ("figures", "movies")
"""Public modules."""

__all__ = [
    "Analysis",
    "CalibrationMissing",
    "CannotMeasure",
    "ChoiceMissing",
    "ClusterUnusable",
    "Config",
    "ConfigError",
    "Decisions",
    "MaskUnusable",
    "MicrobundleError",
    "Movie",
    "MovieUnreadable",
    "NoPillars",
    "NoTexture",
    "NoTissue",
    "OutputError",
    "ResultUnreadable",
    "__version__",
    "alternatives",
    "analyze",
    "compare",
    "compat_columns",
    "decide",
    "displacement_error_at",
    "export_paper",
    "figures",
    "follow_body",
    "follow_points",
    "load",
    "movies",
    "read_decisions",
    "read_mask",
    "read_movie",
    "save",
    "standard_errors",
    "tables",
    "write_comparison",
    "write_decisions",
    "write_index",
    "write_report",
    "write_workbook",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("microbundle")
    if name in _MODULES:
        return import_module(f".{name}", __name__)
    if name in _HOME:
        return getattr(import_module(f".{_HOME[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
