"""The command `batch`: it plans, runs, and prints; `cli` registers it."""

from __future__ import annotations

import sys
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from ..commands import VERDICT_FAIL, Switch, settings_from
from ..config import Config
from ..console import print_json, print_rows

if TYPE_CHECKING:
    from ..events import BatchEvent, TellBatch
    from .plan import Plan
    from .run import Outcome

INTERRUPTED = 130
SHOWN = 100
"""Movies that a table on the screen lists; JSON lists all."""
SHOWN_FAILURES = 20


def batch(source: Path, *, out: Path | None = None, pattern: str | None = None, workers: int | None = None,
          cluster: str | None = None, config_file: Annotated[Path | None, Parameter(name="--config")] = None,
          config: Annotated[Config | None, Parameter(name="*")] = None, report: bool = True, figures: Switch = False,
          movies: Switch = False, excel: Switch = False, wells: int | None = None, retry_failed: Switch = False,
          dry_run: Switch = False, events: Path | None = None, quiet: Switch = False, json: Switch = False) -> int:
    """Measure many movies, and write tables over all of them. The same line again continues where it was stopped.

    Parameters
    ----------
    source
        A folder tree of movies, or a manifest: a CSV file with a column movie, and others such as plate, well, fps.
    out
        Folder for the results; by default NAME_microbundle_batch in the current folder.
    pattern
        Reads columns from the movies' names, such as {plate}_{well}; or a regular expression with named groups.
    workers
        Movies that are measured at the same time; by default one for each processor, or each worker of the cluster.
    cluster
        Measure on a Dask cluster: the address of its scheduler, or its scheduler file (needs the extra `cluster`).
    config_file
        TOML file of settings; flags win over it, and the manifest over both.
    report
        Write report.html for each movie, and an index page over all.
    figures
        Also write the folder figures/ of each result, with limits shared by all movies so that they can be compared.
    movies
        Also write the folder movies/ of each result, with limits shared by all movies.
    excel
        Also write plate.xlsx, one workbook of all tables (needs XlsxWriter).
    wells
        Size of the plates on maps: 6, 12, 24, 48, 96, 384 or 1536; by default the smallest that has all wells.
    retry_failed
        Measure movies again that failed, though nothing has changed.
    dry_run
        Only show what would be measured, and write nothing.
    events
        Add a line of JSON to this file for each thing that happens.
    quiet
        Print nothing but errors.
    json
        Print a line of JSON for each thing that happens, for scripts; with --dry-run one JSON object.
    """
    from .collect import Extras
    from .plan import make_plan
    from .run import run_batch
    from .show import Tally, event_lines, progress

    plan = make_plan(source, config=settings_from(config_file, config), pattern=pattern, report=report,
                     figures=figures, movies=movies)
    out = out or Path(f"{source.resolve().stem}_microbundle_batch")
    if dry_run:
        _print_plan(plan, out, retry_failed, json)
        return 0
    tally = Tally()
    tells: list[TellBatch] = [tally.tell]

    def tell(event: BatchEvent) -> None:
        for one in tells:
            one(event)

    with ExitStack() as open_now:
        if json or events is not None:
            tells.append(open_now.enter_context(event_lines(events, stdout=json)))
        if not (quiet or json):
            tells.append(open_now.enter_context(progress(tally)))
        try:
            outcome = run_batch(plan, out, workers=workers, cluster=cluster, retry=retry_failed, tell=tell,
                                extras=Extras(excel, wells))
        except KeyboardInterrupt:
            open_now.close()
            told = f"interrupted; {tally.ended} of {tally.movies} movies are done and kept. The same line goes on there"
            if json:
                print_json({"error": {"kind": "KeyboardInterrupt", "message": told, "exit_code": INTERRUPTED}})
            print(f"error: {told}", file=sys.stderr)
            return INTERRUPTED
    if not (quiet or json):
        _print_outcome(outcome)
    return VERDICT_FAIL if outcome.failed or outcome.count("fail") else 0


def _print_plan(plan: Plan, out: Path, retry: bool, json: bool) -> None:
    from .run import waiting_for

    states = waiting_for(plan.tasks, out.expanduser().resolve(), plan)
    if retry:
        states = {movie: "to do" if state == "failed" else state for movie, state in states.items()}
    if json:
        print_json({"out": str(out), "notes": plan.notes, "movies": [
            {"movie": task.movie, "path": str(task.path), "result": task.key, "columns": dict(task.columns),
             "state": states[task.movie]} for task in plan.tasks]})
        return
    rows = [(task.movie, *(task.columns.get(name, "") for name in plan.columns), states[task.movie])
            for task in plan.tasks[:SHOWN]]
    counts = Counter(states.values())
    print_rows(f"{len(plan.tasks)} movies: {', '.join(f'{n} {state}' for state, n in sorted(counts.items()))}",
               ("movie", *plan.columns, "state"), rows)
    if len(plan.tasks) > SHOWN:
        print(f"and {len(plan.tasks) - SHOWN} more; --json lists all")
    for note in plan.notes:
        print(f"info: {note}")


def _print_outcome(outcome: Outcome) -> None:
    told = [f"{outcome.count(verdict)} {verdict}" for verdict in ("pass", "review", "fail")]
    told.append(f"{len(outcome.failed)} without a result")
    print(f"{len(outcome.statuses)} movies: {', '.join(told)}"
          + (f"; {outcome.unchanged} of them unchanged since an earlier run" if outcome.unchanged else ""))
    for status in outcome.failed[:SHOWN_FAILURES]:
        print(f"{status.movie}: {status.kind}: {status.message}")
    if len(outcome.failed) > SHOWN_FAILURES:
        print(f"and {len(outcome.failed) - SHOWN_FAILURES} more, in movies.csv")
    for movie, why in list(outcome.undrawn.items())[:SHOWN_FAILURES]:
        print(f"no pictures of {movie}: {why}")
    if len(outcome.undrawn) > SHOWN_FAILURES:
        print(f"and of {len(outcome.undrawn) - SHOWN_FAILURES} more movies")
    for note in outcome.notes:
        print(f"info: {note}")
    for file in outcome.files:
        print(f"results: {file}")
