"""What became of each movie: a small JSON file for each, written whole, after the result that it speaks of.

A run that was killed leaves movies without such a file, or with one of older settings; they are measured again.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Literal

from ..decisions import decisions_hash
from ..errors import OutputError
from ..folder import LIST
from .plan import Plan, Task, fingerprint

KIND = "batch"
RESULTS, STATUS, LOCK = "results", "status", ".microbundle.lock"
TABLE = "summary.csv"


@dataclass(frozen=True)
class Status:
    """What became of one movie."""

    movie: str
    state: Literal["done", "failed"]
    input: str
    """Fingerprint of the movie's files before it was measured."""
    settings: str
    version: str
    decisions: str = ""
    """Hash of a person's decisions that were replayed; empty where there were none."""
    verdict: str = ""
    """Of the result; empty where there is none."""
    beats: int = 0
    kind: str = ""
    """Of the failure: the name of the error."""
    message: str = ""
    lasting: bool = True
    """The same would come of the same movie again; False for a full disk, a killed process and the like."""
    seconds: float = 0.0


def read_status(out: Path, task: Task) -> Status | None:
    """Read what became of a movie; None where nothing is known, or the file is damaged."""
    try:
        return Status(**json.loads((out / STATUS / f"{task.key}.json").read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None


def write_status(out: Path, key: str, status: Status) -> None:
    """Write what became of a movie. Raises OSError."""
    with whole(out / STATUS / f"{key}.json") as stream:
        stream.write(json.dumps(asdict(status), indent=1) + "\n")


def current(out: Path, plan: Plan, task: Task) -> Status | None:
    """Tell what became of a movie, where it would be the same again: unchanged input, settings, decisions and
    version."""
    status = read_status(out, task)
    if status is None or not status.lasting or status.movie != task.movie:
        return None
    if (status.settings, status.version) != (task.settings, plan.version) or status.input != fingerprint(task.path):
        return None
    if status.decisions != decisions_hash(out / RESULTS / task.key):
        return None
    return status if status.state == "failed" or _has_table(out / RESULTS / task.key) else None


def _has_table(result: Path) -> bool:
    """Tell whether a result is there; after a power failure its files may be empty."""
    try:
        return (result / TABLE).stat().st_size > 0
    except OSError:
        return False


@contextmanager
def whole(file: Path) -> Iterator[IO[str]]:
    """Open a text file that appears whole, in place of an older one, when the block ends without an error."""
    handle, partial = tempfile.mkstemp(prefix=f".{file.name}.partial-", dir=file.parent)
    try:
        with open(handle, "w", encoding="utf-8", errors="backslashreplace", newline="") as stream:
            yield stream
        Path(partial).chmod(0o644)
        os.replace(partial, file)
    except BaseException:
        Path(partial).unlink(missing_ok=True)
        raise


@contextmanager
def run_folder(out: Path | str) -> Iterator[Path]:
    """Hold the folder of a run for this process, and clear away what a killed run left half-done.

    Raises OutputError where it holds anything but a run of microbundle, another run works in it, or it cannot be
    written.
    """
    with ExitStack() as held:
        try:
            out = Path(out).expanduser().resolve()
            _check_ours(out)
            for folder in (out / RESULTS, out / STATUS):
                folder.mkdir(parents=True, exist_ok=True)
            lock = held.enter_context((out / LOCK).open("a"))
            if not hold(lock):
                raise OutputError(f"{out}: expected a folder that no other run writes into; one does. Wait for it, or "
                                  "choose another folder with --out")
            if not (out / LIST).exists():
                with whole(out / LIST) as stream:
                    stream.write(json.dumps({"kind": KIND, "files": []}) + "\n")
            clear_partial(out)
        except OSError as error:
            raise OutputError(f"{out}: the folder cannot be written: {error.strerror or error}") from None
        yield out


def clear_partial(out: Path) -> None:
    """Remove what a worker or a run that was killed left half-done."""
    for folder in (out, out / RESULTS, out / STATUS):
        with os.scandir(folder) as entries:
            left = [entry.name for entry in entries if entry.name.startswith(".") and ".partial-" in entry.name]
        for name in left:
            shutil.rmtree(folder / name, ignore_errors=True)
            with suppress(OSError):
                (folder / name).unlink(missing_ok=True)
    _bring_back(out / RESULTS)


def _bring_back(results: Path) -> None:
    """Put a result that was about to be replaced back in place, or away where the new one is there."""
    with os.scandir(results) as entries:
        aside = [Path(entry.path) for entry in entries if entry.name.startswith(".") and ".old-" in entry.name]
    for folder in aside:
        for old in folder.iterdir():
            if not (results / old.name).exists():
                old.rename(results / old.name)
        shutil.rmtree(folder, ignore_errors=True)


def guarded(out: Path, write: Callable[[], None]) -> None:
    """Write files of a run; raises OutputError where that fails."""
    try:
        write()
    except OSError as error:
        raise OutputError(f"{error.filename or out}: the file cannot be written: {error.strerror or error}") from None


def _check_ours(out: Path) -> None:
    if not out.exists():
        return
    if not out.is_dir():
        raise OutputError(f"{out}: expected a folder for the results; there is a file of that name")
    kind = ""
    with suppress(OSError, ValueError, TypeError, KeyError):
        kind = json.loads((out / LIST).read_text(encoding="utf-8"))["kind"]
    others = sorted(name for name in os.listdir(out) if name not in (RESULTS, STATUS) and not name.startswith("."))
    if kind != KIND and others:
        raise OutputError(f"{out}: expected a new or empty folder, or one of an earlier run; it holds something else, "
                          f"such as {others[0]}. Choose another with --out")


def hold(stream: IO[str]) -> bool:
    """Lock a file until this process ends, however it ends; False where another process holds it."""
    try:
        import fcntl
    except ImportError:
        import msvcrt  # Windows

        try:
            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
        except OSError:
            return False
        return True
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
