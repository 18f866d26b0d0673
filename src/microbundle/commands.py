"""The commands: each calls one library function, prints, and returns an exit code.

They are loaded when one is run or asked for help, so that `microbundle --help` stays fast.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from .compat_definitions import ToolName
from .config import Config, merge, read_toml
from .console import number, print_json, print_rows, progress_bar
from .errors import ConfigError

if TYPE_CHECKING:
    import pandas as pd

    from .analysis import Analysis

VERDICT_FAIL = 3
Switch = Annotated[bool, Parameter(negative="")]


def analyze(movie: Path, *, out: Path | None = None, overwrite: Switch = False, tissue_mask: Path | None = None,
            config_file: Annotated[Path | None, Parameter(name="--config")] = None,
            stiffness_un_per_um: float | None = None, excel: Switch = False, compat: list[ToolName] | None = None,
            report: bool = True, config: Annotated[Config | None, Parameter(name="*")] = None,
            figures: Switch = False, movies: Switch = False, quiet: Switch = False, json: Switch = False) -> int:
    """Measure one movie and write a folder of results.

    Parameters
    ----------
    movie
        A folder of single-frame TIFFs (also the layout movie/ and masks/), or a TIFF, ND2, CZI, LIF, AVI, MP4, MOV or
        MKV file; `microbundle info` shows what is in it.
    out
        New folder for the results; by default NAME_microbundle in the current folder. A person's decisions that lie
        beside it (see `microbundle decide`) are replayed.
    overwrite
        Replace an older result in that folder.
    tissue_mask
        Mask of the tissue: text of 0/1, PNG, TIFF, or a polygon as CSV (row,col) or JSON.
    config_file
        TOML file of settings; flags win over it.
    stiffness_un_per_um
        Stiffness of a pillar, in uN/um: gives forces. The same as --pillars.stiffness-un-per-um.
    excel
        Also write one workbook, results.xlsx, with all tables, findings and settings (needs the extra `excel`).
    compat
        Also write the beats in the columns and definitions of another tool; may be given more than once.
    report
        Write report.html, a page with everything to look at, which opens in any browser.
    figures
        Also write the folder figures/: pictures of everything, as PNG and PDF.
    movies
        Also write the folder movies/: displacement and strain over the beating tissue, as MP4.
    quiet
        Print nothing but errors.
    json
        Print one JSON object instead of the table, for scripts.
    """
    if stiffness_un_per_um is not None:
        given = {"pillars": {"stiffness_un_per_um": stiffness_un_per_um}}
        below = config.model_dump(exclude_unset=True) if config is not None else {}
        config = Config.from_dict(merge(below, given), source="command line")
    settings = settings_from(config_file, config)
    from .compat import compat_columns
    from .decisions import read_decisions
    from .folder import check_free
    from .metrics import tables
    from .pipeline import analyze as run
    from .read import movie_name, read_movie
    from .report import NAME as PAGE
    from .report import write_report
    from .store import KIND, save
    from .workbook import NAME, check_writer, write_workbook

    if excel:
        check_writer()
    with progress_bar(quiet or json) as tell:
        named = out or Path(f"{movie_name(movie)}_microbundle")
        folder = check_free(named, KIND, overwrite)
        decided = read_decisions(folder)
        settings = decided.over(settings)
        part = settings.reading
        opened = read_movie(movie, tissue_mask=tissue_mask, series=part.series, channel=part.channel, z=part.z)
        analysis = run(opened, settings, decisions=decided, tell=tell)
        made = tables(analysis) | {f"compat_{tool}": compat_columns(analysis, tool) for tool in compat or ()}

        left_out: dict[str, str] = {}

        def beside(into: Path) -> None:
            if figures:
                from .figures import save_all as save_figures

                left_out.update({f"figure {kind}": why for kind, why in
                                 save_figures(analysis, into / "figures").left_out.items()})
            if movies:
                from .movies import save_all as save_movies

                left_out.update({f"movie {show}": why for show, why in
                                 save_movies(opened, analysis, into / "movies").items()})
            if excel:
                write_workbook(analysis, into / NAME, made)
            if report:
                filmed = into / "movies" / "displacement.mp4"
                write_report(analysis, into / PAGE, made=made, movie=filmed if filmed.is_file() else None)

        folder = save(analysis, folder, overwrite=overwrite, made=made, extra=beside)
    print_result(analysis, made["summary"], folder, quiet=quiet, json=json)
    for name, why in left_out.items() if not (quiet or json) else ():
        print(f"info: no {name}: {why}")
    return VERDICT_FAIL if analysis.verdict == "fail" else 0


def info(file: Path, *, series: int | None = None, channel: int | None = None, z: int | None = None,
         json: Switch = False) -> int:
    """Show what is inside a movie file or folder, and what would be taken from it.

    Parameters
    ----------
    file
        A folder of TIFFs, or a TIFF, ND2, CZI, LIF, AVI, MP4, MOV or MKV file.
    series
        Which recording of several, counted from 0.
    channel
        Which channel of several, counted from 0.
    z
        Which focal plane of several, counted from 0.
    json
        Print one JSON object.
    """
    from .read import describe

    found = describe(file, series=series, channel=channel, z=z)
    if json:
        print_json(found)
        return 0
    rows = [(str(i), s["name"], " ".join(f"{axis} {n}" for axis, n in s["sizes"].items()), ", ".join(s["channels"]),
             f"{s['bits'] or ''}", s["compression"]) for i, s in enumerate(found["series"])]
    print_rows(f"{found['file']}: {found['format']}", ("series", "name", "sizes", "channels", "bits", "compression"),
               rows)
    movie = found["movie"]
    if movie is None:
        print(found["to_choose"])
        return 0
    print(f"movie: {movie['frames']} frames of {movie['rows']} x {movie['cols']} px, {movie['number_type']}")
    for name, value, unit in (("pixel size", "um_per_px", "um"), ("frame rate", "frames_per_s", "1/s")):
        source = movie["um_per_px_source" if value == "um_per_px" else "time_source"]
        print(f"{name}: not known" if movie[value] is None else
              f"{name}: {number(movie[value])} {unit} (from the {source})")
    for finding in movie["findings"]:
        print(f"{finding['level']}: {finding['message']}")
    return 0


def trace(file: Path, *, fps: float | None = None, inverted: Switch = False, result: Path | None = None,
          out: Path | None = None, json: Switch = False) -> int:
    """Measure the beats of a trace, such as calcium or voltage, and the delay of the contraction.

    Parameters
    ----------
    file
        Table with a column time_s and one of values (or one column and --fps), or a second channel's movie, of which
        the mean over the tissue's mask is taken (needs --result).
    fps
        Values or frames per second, where the file has no times.
    inverted
        Beats are dips.
    result
        Result of `microbundle analyze` that the trace belongs to: both start at the same time.
    out
        New CSV file for the table.
    json
        Print one JSON object instead of the table.
    """
    from .errors import OutputError
    from .store import load
    from .trace import cut_trace, mean_trace, read_trace, trace_table

    analysis = None if result is None else load(result)
    if analysis is not None and (file.is_dir() or file.suffix.lower() not in (".csv", ".txt", ".tsv", ".dat")):
        from .read import calibrated, read_movie

        time_s, value = mean_trace(calibrated(read_movie(file), fps, None), analysis.masks.tissue)
    else:
        time_s, value = read_trace(file, fps=fps)
    found = cut_trace(file.stem, time_s, value, inverted=inverted)
    table = trace_table(found, analysis)
    if out is not None:
        try:
            with out.open("x", encoding="utf-8", newline="") as stream:
                table.to_csv(stream, index=False, float_format="%.7g", lineterminator="\n")
        except OSError as error:
            raise OutputError(f"{out}: expected a new file for the table: {error.strerror or error}") from None
    whole = table[table["complete"]] if len(table) else table
    means = {str(name): float(whole[name].mean()) for name in whole.columns if name not in ("beat", "complete")}
    if json:
        print_json({"name": found.name, "beats": len(whole), "metrics": means,
                    "findings": [vars(f) for f in found.findings]})
        return 0
    rows = [(name, number(value)) for name, value in means.items() if "_se" not in name]
    print_rows(f"{found.name}: {len(whole)} whole beats", ("metric", "mean"), rows)
    for finding in found.findings:
        print(f"{finding.level}: {finding.message}")
    return 0


def metrics(key: str | None = None, /, *, json: Switch = False) -> int:
    """Print the dictionary of metrics: every key with its unit and definition, or all about one.

    Parameters
    ----------
    key
        A key such as amplitude, or a column such as amplitude_um.
    json
        Print one JSON object.
    """
    from .dictionary import METRICS
    from .lookup import as_dict, entries, entry_lines, list_lines

    found = METRICS if key is None else entries(key)
    if json:
        print_json({"metrics": [as_dict(metric) for metric in found]})
        return 0
    lines = list_lines() if key is None else (line for metric in found for line in entry_lines(metric))
    print("\n".join(lines))
    return 0


def export(result: Path, *, out: Path, layout: str = "paper", overwrite: Switch = False, quiet: Switch = False) -> int:
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


def report(result: Path, *, out: Path | None = None, movie: Path | None = None, overwrite: Switch = False,
           quiet: Switch = False) -> int:
    """Write the report of a result again, from its result file alone.

    Parameters
    ----------
    result
        Folder or result.nc that `microbundle analyze` wrote.
    out
        New HTML file; by default report.html beside the result file.
    movie
        MP4 to show in the report, of up to 4 MB.
    overwrite
        Replace an older report.
    quiet
        Print nothing but errors.
    """
    from .report import NAME, write_report
    from .store import load

    home = result if result.is_dir() else result.parent
    file = write_report(load(result), out or home / NAME, movie=movie, overwrite=overwrite)
    if not quiet:
        print(file)
    return 0


def decide(result: Path, *, drop_beat: list[int] | None = None, mark_beat: list[tuple[int, int, int]] | None = None,
           mask: list[Path] | None = None, accept: Switch = False, reject: Switch = False, note: str | None = None,
           config_file: Annotated[Path | None, Parameter(name="--config")] = None, why: str = "", by: str = "",
           forget: list[int] | None = None, json: Switch = False) -> int:
    """Write down what a person decides about a movie; measuring it again replays that. Without a decision, list them.

    Parameters
    ----------
    result
        Folder that `microbundle analyze` wrote, or is going to write; decisions lie beside it, as
        NAME.decisions.json. In a batch: OUT/results/NAME.
    drop_beat
        Leave out the beat that this frame belongs to; may be given more than once.
    mark_beat
        A beat lies here, in place of what was found: first frame, frame of the peak, first frame after it.
    mask
        Take this mask of the tissue, or of a pillar where the file's name holds pillar_1, pillar_2, ...; it is copied
        beside the decisions.
    accept
        Accept the numbers: the verdict review becomes pass.
    reject
        Reject the numbers: the verdict becomes fail.
    note
        Text that is kept with the movie.
    config_file
        TOML file of settings for this movie alone; they win over all others.
    why
        Reason of these decisions.
    by
        Who decides.
    forget
        Take back the decisions with these numbers, as the list shows them.
    json
        Print one JSON object.
    """
    from .decide import decide as write_down

    if accept and reject:
        raise ConfigError("command line: expected --accept or --reject; found both")
    decided = write_down(result, drop_beats=drop_beat or (), mark_beats=mark_beat or (), masks=mask or (),
                         accept=True if accept else False if reject else None, note=note,
                         settings=None if config_file is None else read_toml(config_file), why=why, by=by,
                         forget=forget or ())
    if json:
        print_json({"decisions": decided.as_list()})
        return 0
    rows = [(str(number), one["kind"], ", ".join(f"{k} {v}" for k, v in one.items() if k != "kind"))
            for number, one in enumerate(decided.as_list())]
    print_rows(f"{len(rows)} decisions on {result}", ("number", "kind", "what"), rows)
    return 0


def demo(*, out: Path | None = None, quiet: Switch = False, json: Switch = False) -> int:
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
    """Lay the flags over the TOML file, and check the file and the whole. Raises ConfigError."""
    above = flags.model_dump(exclude_unset=True) if flags is not None else {}
    if config_file is None:
        return Config.from_dict(above, source="command line")
    below = read_toml(config_file)
    Config.from_dict(below, source=str(config_file))
    return Config.from_dict(merge(below, above), source=f"command line with {config_file}")


def print_result(analysis: Analysis, summary: pd.DataFrame, folder: Path, *, quiet: bool, json: bool) -> None:
    """Print the short table of a result from its summary, or its JSON, and its findings."""
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
    rows = [(str(r["metric"]), number(r["mean"]), number(r["sd"]), str(int(r["n"]))) for _, r in shown.iterrows()]
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
            f"amplitude_{length}", f"cd50_{'s' if timed else 'frames'}", "twitch_force_un", "e_cc_peak", "e_cc_min",
            f"synchrony_sd_{'s' if timed else 'frames'}"]
