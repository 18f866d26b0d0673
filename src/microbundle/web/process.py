"""The process of a run: started so that it outlives the app, found again by a later one, and interrupted.

A process number may be another process's by now. It is taken for ours only where its command names the run's folder.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ..errors import OutputError
from .records import Home, Record, State, process_arguments

ERROR = "error: "
"""How the command line begins to say what went wrong."""
INTERRUPTED = 130
APART = getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)


@dataclass(frozen=True)
class Ending:
    """How a process ended: the state of its run, and what there is to say."""

    state: State
    message: str


def launch(home: Home, record: Record) -> subprocess.Popen[bytes]:
    """Start the process of a run in a session of its own, its words going to the log. Raises OutputError."""
    try:
        with home.log.open("ab") as log:
            return subprocess.Popen(process_arguments(home, record), stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                                    cwd=home.runs, start_new_session=True, creationflags=APART)
    except OSError as error:
        raise OutputError(f"{home.out}: the run cannot be started: {error.strerror or error}") from None


def lives(home: Home, pid: int | None) -> bool:
    """Tell whether the process of a run, started by an earlier app, still works."""
    return pid is not None and str(home.out) in command_of(pid)


def command_of(pid: int) -> str:
    """The command line of a process; nothing where there is none, or it has ended and only waits to be reaped."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
    except OSError:
        pass
    if sys.platform == "win32":
        question = ["powershell", "-NoProfile", "-Command",
                    f"(Get-CimInstance Win32_Process -Filter 'ProcessId={pid}').CommandLine"]
    else:
        question = ["ps", "-ww", "-o", "command=", "-p", str(pid)]
    with suppress(OSError, subprocess.SubprocessError):
        return subprocess.run(question, capture_output=True, text=True, timeout=10, check=False).stdout
    return ""


def interrupt(pid: int) -> None:
    """Ask a process to stop, as Ctrl-C does: it keeps what is done."""
    with suppress(ProcessLookupError):
        os.kill(pid, getattr(signal, "CTRL_BREAK_EVENT", signal.SIGINT))


def end(pid: int) -> None:
    """End a process that did not stop when it was asked; results appear whole, so none is lost."""
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGTERM)


def ending(home: Home, record: Record, code: int | None, completed: bool) -> Ending:
    """Say how the process of a run ended, by its exit code where it is known, and what it said last."""
    said = last_words(home.log, record.log_from)
    if record.cancelled and code != 0 and not completed:
        return Ending("stopped", "Cancelled. What was done is kept; Continue goes on from there.")
    if code in (0, 3) or (code is None and completed):
        return Ending("done", "")
    if code == INTERRUPTED or said.startswith("interrupted"):
        return Ending("stopped", "Interrupted from outside. What was done is kept; Continue goes on from there.")
    if said:
        return Ending("failed", said)
    how = "" if code is None else f" ({_named(code)})"
    return Ending("stopped", f"The process that measured ended without a word{how}: it was killed, or the computer was "
                  "switched off. What was done is kept; Continue goes on from there.")


def last_words(log: Path, start: int) -> str:
    """Read the error that a process told last, or how it broke down; nothing where it told nothing."""
    try:
        with log.open("rb") as stream:
            stream.seek(max(start, log.stat().st_size - 20_000))
            text = stream.read().decode(errors="replace")
    except OSError:
        return ""
    _, found, said = f"\n{text}".rpartition(f"\n{ERROR}")
    if found:
        return said.strip()
    lines = text.strip().splitlines()
    return f"the program failed: {lines[-1].strip()}; please report this, with the file {log.name}" if lines else ""


def _named(code: int) -> str:
    if code >= 0:
        return f"exit code {code}"
    with suppress(ValueError):
        return f"killed by {signal.Signals(-code).name}"
    return f"killed by signal {-code}"
