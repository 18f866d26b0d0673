"""What the commands print: tables and JSON for the output, progress for the error stream."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator
    from contextlib import AbstractContextManager

    from .events import Tell


def print_rows(title: str, header: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> None:
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

    print(json.dumps(plain(content)))


def plain(value: Any) -> Any:
    """Make plain values for JSON: numpy's numbers become Python's, and what is not a number becomes None."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if hasattr(value, "item"):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def number(value: float) -> str:
    """Write a number with four digits, and what is not known as nothing."""
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
