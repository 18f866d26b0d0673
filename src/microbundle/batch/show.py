"""A run as it goes on: counts, a bar for people on the error stream, and lines of JSON for programs."""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path

from ..errors import OutputError
from ..events import BatchEvent, Failed, Finished, Planned, Progressed, Started, TellBatch, as_dict, ignore


class Tally:
    """Counts of a run, kept up to date by its events."""

    def __init__(self) -> None:
        self.movies = self.unchanged = 0
        self.verdicts: Counter[str] = Counter()
        self.shares: dict[str, float] = {}
        """Of the movies that are being measured."""

    def tell(self, event: BatchEvent) -> None:
        """Hear an event."""
        if isinstance(event, Planned):
            self.movies, self.unchanged = event.movies, event.unchanged
        elif isinstance(event, Started):
            self.shares[event.movie] = 0.0
        elif isinstance(event, Progressed):
            self.shares[event.movie] = event.share
        elif isinstance(event, Finished | Failed):
            self.shares.pop(event.movie, None)
            self.verdicts[event.verdict if isinstance(event, Finished) else "failed"] += 1

    @property
    def ended(self) -> int:
        """Movies that need no more work."""
        return self.unchanged + self.verdicts.total()

    def __str__(self) -> str:
        return " ".join(f"{self.verdicts[name]} {name}" for name in ("pass", "review", "fail", "failed")
                        if self.verdicts[name])


@contextmanager
def progress(tally: Tally) -> Iterator[TellBatch]:
    """Show a bar, the counts by verdict and the time left on the error stream; nothing where nobody looks at it."""
    if not sys.stderr.isatty():
        yield ignore
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.fields[ended]}/{task.fields[movies]} movies"), BarColumn(),
               TimeRemainingColumn(compact=True), TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True), transient=True, speed_estimate_period=600) as shown:
        bar = shown.add_task("", total=None, ended=0, movies=0)

        def tell(event: BatchEvent) -> None:
            shown.update(bar, total=tally.movies - tally.unchanged, description=str(tally), ended=tally.ended,
                         completed=tally.verdicts.total() + sum(tally.shares.values()), movies=tally.movies)
            if isinstance(event, Failed):
                shown.console.print(f"{event.movie}: {event.kind}", markup=False, highlight=False)

        yield tell


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
