"""What is kept of each run beside its results: a small JSON file, written whole at each change."""

from __future__ import annotations

import hashlib
import json
import re
import shlex
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from ..batch.state import whole

State = Literal["preparing", "draft", "queued", "running", "done", "stopped", "failed"]
ACTIVE = ("preparing", "queued", "running")
EXTRAS = ("figures", "movies", "excel")
"""What a batch run may make besides, as flags of the command."""


@dataclass(frozen=True)
class Record:
    """One run, as the app knows it."""

    id: str
    title: str
    source: str
    """Full path of the folder, manifest or movie."""
    created: str
    state: State = "draft"
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Nested, as in a TOML file of settings."""
    pattern: str | None = None
    report: bool = True
    figures: bool = False
    movies: bool = False
    excel: bool = False
    queued: str | None = None
    started: str | None = None
    ended: str | None = None
    pid: int | None = None
    code: int | None = None
    """How its last process ended, where that is known."""
    message: str = ""
    """What there is to say about the state."""
    events_from: int = 0
    """Where the events of its last process begin in their file, in bytes."""
    log_from: int = 0
    cancelled: bool = False
    count: int | None = None
    """Movies of its plan, where that was made."""
    wells: int | None = None
    """Size of its plates, where that is set."""
    out: str | None = None
    """Folder of a run that a terminal began; None for one of the workspace."""

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z0-9][a-z0-9-]{0,80}", self.id):
            raise ValueError(f"id: {self.id!r}")


@dataclass(frozen=True)
class Home:
    """Where the files of a run lie."""

    runs: Path
    id: str
    elsewhere: Path | None = None
    """Folder of a run that a terminal began."""

    @property
    def out(self) -> Path:
        """The batch run's own folder."""
        return self.elsewhere or self.runs / self.id

    @property
    def record(self) -> Path:
        return self.runs / f"{self.id}.json"

    @property
    def events(self) -> Path:
        return self.runs / f"{self.id}.events.jsonl"

    @property
    def log(self) -> Path:
        return self.runs / f"{self.id}.log"

    @property
    def settings(self) -> Path:
        return self.runs / f"{self.id}.settings.toml"


def now() -> str:
    """The time, as it is written in records."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def new_id(title: str, created: str, taken: set[str]) -> str:
    """Make a name for a run that is safe in paths and addresses."""
    plain = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")[:40] or "run"
    for attempt in range(1000):
        found = f"{plain}-{hashlib.sha256(f'{title}{created}{attempt}'.encode()).hexdigest()[:6]}"
        if found not in taken:
            return found
    raise ValueError(f"{title}: no free name")


def write_record(home: Home, record: Record) -> None:
    """Write a record. Raises OSError."""
    with whole(home.record) as stream:
        stream.write(json.dumps(asdict(record), indent=1) + "\n")


def read_records(runs: Path) -> list[Record]:
    """Read all records; a damaged one is left out."""
    known = {one.name for one in fields(Record)}
    out = []
    for file in sorted(runs.glob("*.json")):
        try:
            kept = json.loads(file.read_text(encoding="utf-8"))
            out.append(Record(**{name: value for name, value in kept.items() if name in known}))
        except (OSError, ValueError, TypeError, AttributeError):
            continue
    return out


def arguments(home: Home, record: Record) -> list[str]:
    """The command of a run, as a person would type it after `microbundle`."""
    out = ["batch", record.source, "--out", str(home.out)]
    if record.settings:
        out += ["--config", str(home.settings)]
    if record.pattern:
        out.append(f"--pattern={record.pattern}")
    if record.wells is not None:
        out.append(f"--wells={record.wells}")
    if not record.report:
        out.append("--no-report")
    return out + [f"--{name}" for name in EXTRAS if getattr(record, name)]


def command(home: Home, record: Record) -> str:
    """The command of a run, to paste into a terminal."""
    return shlex.join(["microbundle", *arguments(home, record)])


def process_arguments(home: Home, record: Record) -> list[str]:
    """The command of a run, as the app starts it."""
    return [sys.executable, "-m", "microbundle", *arguments(home, record), "--events", str(home.events), "--quiet"]


def toml(settings: Mapping[str, Any]) -> str:
    """Write nested settings as TOML: what JSON writes of texts, numbers and lists is TOML too."""
    plain = {key: value for key, value in settings.items() if not isinstance(value, Mapping) and value is not None}
    lines = [f"{key} = {_value(value)}" for key, value in plain.items()]
    for key, inside in settings.items():
        if isinstance(inside, Mapping) and inside:
            lines += ["", f"[{key}]", toml(inside).rstrip("\n")]
    return "\n".join(lines).lstrip("\n") + "\n"


def _value(value: Any) -> str:
    return json.dumps(value, ensure_ascii=True, allow_nan=False)
