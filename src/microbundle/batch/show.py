"""A run as it goes on: for people a bar, counts and what is being measured, on the error stream; for programs lines of
JSON."""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import OutputError
from ..events import (
    BatchEvent,
    Drawing,
    Drawn,
    Failed,
    Finished,
    Planned,
    Progressed,
    Started,
    TellBatch,
    as_dict,
    ignore,
)

if TYPE_CHECKING:
    from rich.console import RenderableType

MOST_LINES = 8
"""Movies at work that are named below the bar; of more only the number is shown."""
NAME_WIDTH, STAGE_WIDTH, BAR_WIDTH = 32, 22, 20
COUNTED = {"pass": ("green", "pass"), "review": ("yellow", "review"), "fail": ("red", "fail"),
           "failed": ("red", "without a result")}


class Tally:
    """Counts of a run, kept up to date by its events."""

    def __init__(self) -> None:
        self.movies = self.unchanged = 0
        self.verdicts: Counter[str] = Counter()
        self.at_work: dict[str, tuple[str, float]] = {}
        """Stage and share of the movies that are being worked on."""
        self.pictures: int | None = None
        """Movies whose pictures are to be drawn; None until that begins."""
        self.drawn = self.undrawn = 0

    def tell(self, event: BatchEvent) -> None:
        """Hear an event."""
        if isinstance(event, Planned):
            self.movies, self.unchanged = event.movies, event.unchanged
        elif isinstance(event, Started):
            self.at_work[event.movie] = "starting", 0.0
        elif isinstance(event, Progressed):
            self.at_work[event.movie] = event.stage, event.share
        elif isinstance(event, Finished | Failed):
            self.at_work.pop(event.movie, None)
            self.verdicts[event.verdict if isinstance(event, Finished) else "failed"] += 1
        elif isinstance(event, Drawing):
            self.pictures = event.movies - event.unchanged
        elif isinstance(event, Drawn):
            self.at_work.pop(event.movie, None)
            self.drawn += not event.problem
            self.undrawn += bool(event.problem)

    @property
    def ended(self) -> int:
        """Movies that need no more measuring."""
        return self.unchanged + self.verdicts.total()

    @property
    def done(self) -> float:
        """What this run has done of the step it is at, in movies."""
        whole = self.verdicts.total() if self.pictures is None else self.drawn + self.undrawn
        return whole + sum(share for _, share in self.at_work.values())

    @property
    def to_do(self) -> int:
        """Movies that this run has or had to work on in the step it is at."""
        return self.movies - self.unchanged if self.pictures is None else self.pictures


@contextmanager
def progress(tally: Tally) -> Iterator[TellBatch]:
    """Show a bar, the counts by verdict, the time left and the movies at work on the error stream; nothing where nobody
    looks at it."""
    if not sys.stderr.isatty():
        yield ignore
        return
    from rich.console import Console
    from rich.live import Live

    shown = Screen(tally)
    with Live(get_renderable=shown, console=Console(stderr=True), transient=True, refresh_per_second=4) as live:
        def tell(event: BatchEvent) -> None:
            if isinstance(event, Failed):
                live.console.print(f"{event.movie}: {event.kind}", markup=False, highlight=False)
            elif isinstance(event, Drawn) and event.problem:
                live.console.print(f"no pictures of {event.movie}", markup=False, highlight=False)

        yield tell


class Screen:
    """What a person sees of a run: calling it gives the lines as they are now."""

    def __init__(self, tally: Tally) -> None:
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (TextColumn("{task.fields[counted]}"), BarColumn(), TimeRemainingColumn(compact=True))
        self._tally, self._bar = tally, Progress(*columns, speed_estimate_period=600)
        self._step = self._bar.add_task("", total=None, counted="")
        self._drawing = False

    def __call__(self) -> RenderableType:
        from rich.console import Group
        from rich.text import Text

        tally = self._tally
        if tally.pictures is not None and not self._drawing:
            self._drawing = True
            self._bar.reset(self._step)
        counted = (f"{tally.ended}/{tally.movies} movies" if tally.pictures is None else
                   f"pictures of {tally.drawn + tally.undrawn}/{tally.pictures} movies")
        self._bar.update(self._step, total=tally.to_do, completed=tally.done, counted=counted)
        verdicts = [(f"{tally.verdicts[key]} {name}  ", colour) for key, (colour, name) in COUNTED.items()
                    if tally.verdicts[key]]
        return Group(self._bar, *([Text.assemble("  ", *verdicts)] if verdicts else []), *self._at_work())

    def _at_work(self) -> list[RenderableType]:
        from rich.progress_bar import ProgressBar
        from rich.table import Table
        from rich.text import Text

        now = list(self._tally.at_work.items())
        lines = Table.grid(padding=(0, 1))
        for width in (NAME_WIDTH, STAGE_WIDTH, BAR_WIDTH):
            lines.add_column(width=width, no_wrap=True, overflow="ellipsis")
        for movie, (stage, share) in now[:MOST_LINES]:
            name = movie if len(movie) <= NAME_WIDTH - 2 else f"…{movie[3 - NAME_WIDTH:]}"  # the end tells the well
            lines.add_row(Text(f"  {name}"), Text(stage), ProgressBar(1.0, share, width=BAR_WIDTH))
        more = len(now) - MOST_LINES
        return [lines, *([Text(f"  and {more} more")] if more > 0 else [])]


@contextmanager
def event_lines(file: Path | None, *, stdout: bool) -> Iterator[TellBatch]:
    """Write a line of JSON for each event, with its time in UTC, to the end of a file, the output, or both.

    Raises OutputError where the file cannot be opened or written.
    """
    with ExitStack() as held:
        try:
            stream = None if file is None else held.enter_context(file.expanduser().open("a", encoding="utf-8"))
        except OSError as error:
            raise _unwritable(file, error) from None

        def tell(event: BatchEvent) -> None:
            line = json.dumps(as_dict(event) | {"at": datetime.now(UTC).isoformat(timespec="milliseconds")})
            if stdout:
                print(line, flush=True)
            if stream is not None:
                try:
                    stream.write(line + "\n")
                    stream.flush()
                except OSError as error:
                    raise _unwritable(file, error) from None

        yield tell


def _unwritable(file: Path | None, error: OSError) -> OutputError:
    return OutputError(f"{file}: the events cannot be written: {error.strerror or error}")
