"""The command line: parse, call one library function, print, return an exit code.

Exit codes: 0 done; 2 wrong command line or settings; 3 result written, but its verdict is "fail"; 4 movie or mask
cannot be read; 5 movie cannot be measured; 6 results cannot be written; 130 interrupted.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, CycloptsError, Parameter

from .config import Config, explain, merge, read_toml
from .errors import ConfigError, MicrobundleError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from contextlib import AbstractContextManager

    from .analysis import Analysis
    from .events import Tell

VERDICT_FAIL = 3
INTERRUPTED = 130

app = App(name="microbundle", help="Displacement, strain and beat metrics from movies of cardiac microbundles.",
          version_flags=["--version"])


@app.command
def analyze(movie: Path, *, out: Path | None = None, overwrite: bool = False, tissue_mask: Path | None = None,
            config_file: Annotated[Path | None, Parameter(name="--config")] = None,
            config: Annotated[Config | None, Parameter(name="*")] = None,
            quiet: bool = False, json: bool = False) -> int:
    """Measure one movie and write a folder of results.

    Parameters
    ----------
    movie
        A folder of single-frame TIFFs (also the layout movie/ and masks/), or a multi-page TIFF.
    out
        New folder for the results; by default NAME_microbundle in the current folder.
    overwrite
        Replace an older result in that folder.
    tissue_mask
        Mask of the tissue: text of 0/1, PNG, TIFF, or a polygon as CSV (row,col) or JSON.
    config_file
        TOML file of settings; flags win over it.
    quiet
        Print nothing but errors.
    json
        Print one JSON object instead of the table, for scripts.
    """
    settings = settings_from(config_file, config)
    from .pipeline import analyze as run
    from .read import read_movie
    from .store import check_free, save

    with progress_bar(quiet or json) as tell:
        opened = read_movie(movie, fps=settings.fps, um_per_px=settings.um_per_px, tissue_mask=tissue_mask)
        folder = out or Path(f"{opened.name}_microbundle")
        check_free(folder, overwrite)
        analysis = run(opened, settings, tell=tell)
        folder = save(analysis, folder, overwrite=overwrite)
    report(analysis, folder, quiet=quiet, json=json)
    return VERDICT_FAIL if analysis.verdict == "fail" else 0


@app.command
def export(result: Path, *, out: Path, layout: str = "paper", overwrite: bool = False, quiet: bool = False) -> int:
    """Write a result in another layout.

    Parameters
    ----------
    result
        Folder or result.nc that `microbundle analyze` wrote.
    out
        New folder for the files.
    layout
        `paper`: the text files of MicroBundleCompute.
    overwrite
        Replace an older export in that folder.
    quiet
        Print nothing but errors.
    """
    if layout != "paper":
        raise ConfigError(f"--layout: expected paper; found {layout!r}")
    from .paper_layout import export_paper
    from .store import load

    folder = export_paper(load(result), out, overwrite=overwrite)
    if not quiet:
        print(folder)
    return 0


@app.command
def demo(*, out: Path | None = None, quiet: bool = False, json: bool = False) -> int:
    """Render a small beating tissue with known motion, analyze it, and print what was measured beside the truth.

    Parameters
    ----------
    out
        Also write the results into this new folder.
    quiet
        Print nothing but errors.
    json
        Print one JSON object instead of the table.
    """
    from .demo import run_demo

    with progress_bar(quiet or json) as tell:
        outcome = run_demo(tell)
        if out is not None:
            from .store import save

            save(outcome.analysis, out)
    if json:
        print_json(outcome.as_dict())
    elif not quiet:
        print_rows("A rendered tissue with known motion", ("metric", "truth", "measured", "error"), outcome.rows())
    return 0


def settings_from(config_file: Path | None, flags: Config | None) -> Config:
    """Lay the flags over the TOML file, and check the whole. Raises ConfigError."""
    below = read_toml(config_file) if config_file is not None else {}
    above = flags.model_dump(exclude_unset=True) if flags is not None else {}
    return Config.from_dict(merge(below, above), source=str(config_file or "command line"))


def report(analysis: Analysis, folder: Path, *, quiet: bool, json: bool) -> None:
    """Print the short table of a result, or its JSON, and its findings."""
    from .metrics import tables

    summary = tables(analysis)["summary"]
    if json:
        metrics = {str(row["metric"]): {k: row[k] for k in ("n", "mean", "sd", "low_95", "high_95")}
                   for _, row in summary.iterrows()}
        print_json({
            "name": analysis.name, "verdict": analysis.verdict, "out": str(folder), "frames": analysis.frame_count,
            "beats": int(analysis.beats.complete.sum()), "markers": len(analysis.markers),
            "findings": [vars(f) for f in analysis.findings], "metrics": metrics,
        })
        return
    if quiet:
        return
    shown = summary[summary["metric"].isin(_shown(analysis))]
    rows = [(str(r["metric"]), _number(r["mean"]), _number(r["sd"]), str(int(r["n"]))) for _, r in shown.iterrows()]
    print_rows(f"{analysis.name}: {analysis.verdict}", ("metric", "mean", "sd", "n"), rows)
    for finding in analysis.findings:
        print(f"{finding.level}: {finding.message}")
    if analysis.um_per_px is None or analysis.time_s is None:
        unknown = [text for text, missing in (("pixel size (--um-per-px)", analysis.um_per_px is None),
                                              ("frame rate (--fps)", analysis.time_s is None)) if missing]
        print(f"info: not known, so no such units: {' and '.join(unknown)}")
    print(f"results: {folder}")


def _shown(analysis: Analysis) -> list[str]:
    length = "um" if analysis.um_per_px is not None else "px"
    timed = analysis.time_s is not None
    return [f"tissue_width_{length}", f"beat_period_{'s' if timed else 'frames'}", "beat_rate_bpm",
            f"amplitude_{length}", "e_cc_peak", "e_cc_min", f"synchrony_sd_{'s' if timed else 'frames'}"]


def print_rows(title: str, header: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """Print a small table."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for i, name in enumerate(header):
        table.add_column(name, justify="left" if i == 0 else "right")
    for row in rows:
        table.add_row(*row)
    Console().print(table)


def print_json(content: dict[str, Any]) -> None:
    """Print one JSON object; what is not a number becomes null."""
    import json
    import math

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {str(k): plain(v) for k, v in value.items()}
        if isinstance(value, list | tuple):
            return [plain(v) for v in value]
        if hasattr(value, "item"):
            value = value.item()
        return None if isinstance(value, float) and not math.isfinite(value) else value

    print(json.dumps(plain(content)))


def _number(value: float) -> str:
    return "" if value != value else f"{value:.4g}"


def progress_bar(silent: bool) -> AbstractContextManager[Tell]:
    """Show the stage and the time left on the error stream, while the block runs."""
    from contextlib import contextmanager

    from .events import Progress, ignore

    @contextmanager
    def bar() -> Iterator[Tell]:
        if silent or not sys.stderr.isatty():
            yield ignore
            return
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        columns = TextColumn("{task.description:<24}"), BarColumn(), TimeRemainingColumn(compact=True)
        with Bar(*columns, console=Console(stderr=True), transient=True) as shown:
            task = shown.add_task("reading", total=1.0)

            def tell(event: Progress) -> None:
                shown.update(task, description=event.stage, completed=event.share)

            yield tell

    return bar()


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and leave with its exit code; a user never sees a traceback for bad input."""
    sys.exit(run(sys.argv[1:] if arguments is None else arguments))


def run(arguments: list[str]) -> int:
    """Run the command line and return its exit code."""
    from pydantic import ValidationError

    as_json = "--json" in arguments
    try:
        code = app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
        return code if isinstance(code, int) else 0
    except MicrobundleError as error:
        return _fail(str(error), type(error).__name__, error.exit_code, as_json)
    except CycloptsError as error:
        cause = error.__cause__ or error.__context__
        text = explain(cause, "command line") if isinstance(cause, ValidationError) else str(error)
        return _fail(text, "ConfigError", ConfigError.exit_code, as_json)
    except KeyboardInterrupt:
        return _fail("interrupted; nothing was written", "KeyboardInterrupt", INTERRUPTED, as_json)


def _fail(message: str, kind: str, code: int, as_json: bool) -> int:
    if as_json:
        print_json({"error": {"kind": kind, "message": message, "exit_code": code}})
    print(f"error: {message}", file=sys.stderr)
    return code
