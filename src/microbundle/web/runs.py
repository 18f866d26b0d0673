"""The runs: opened, set, queued, started one after another, followed, cancelled, and found again by a later app.

A run belongs to its own process and to its files; what is here can be made again from them. Each change is written
before it is told. All methods may be called from any thread.
"""

from __future__ import annotations

import logging
import os
import shutil
import subprocess
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..batch.collect import MOVIES
from ..batch.find import kind_of
from ..batch.plan import Plan, make_plan
from ..batch.recipe import read_recipe
from ..batch.state import LOCK, STATUS, hold, whole
from ..config import Config
from ..errors import MicrobundleError
from . import process
from .answers import Refused, not_there
from .example import render
from .places import EXAMPLE, LOOKED_AT, Places
from .progress import Progress
from .records import ACTIVE, EXTRAS, Home, Record, command, new_id, now, read_records, toml, write_record

PATIENCE = 40
"""Looks at a process that was asked to stop, until it is ended."""
TRASH = "trash"
CHANGED: dict[str, Any] = {"title": str, "settings": dict, "pattern": (str, type(None)),
                           **dict.fromkeys(EXTRAS, bool)}
"""What may be changed of a run, and of which kind it is."""

log = logging.getLogger(__name__)


class Runs:
    """All runs of a workspace."""

    def __init__(self, workspace: Path, places: Places) -> None:
        self.folder, self.trash, self.places = workspace / "runs", workspace / TRASH, places
        self.folder.mkdir(parents=True, exist_ok=True)
        self._lock = threading.RLock()
        self._records: dict[str, Record] = {}
        self._progress: dict[str, Progress] = {}
        self._plans: dict[str, Plan] = {}
        self._children: dict[str, subprocess.Popen[bytes]] = {}
        self._asked: dict[str, int] = {}
        self.preparing: dict[str, float] = {}
        """Share of each example plate that is rendered."""
        self.version = 0
        """Grows with each change of any record."""
        for record in read_records(self.folder):
            self._records[record.id] = record
            self._progress[record.id] = Progress(self._home(record).events, record.events_from)
        for record in list(self._records.values()):
            if record.state == "preparing":
                self._prepare(record)

    def home(self, id: str) -> Home:
        """Where the files of a run lie. Raises Refused."""
        return self._home(self.get(id))

    def _home(self, record: Record) -> Home:
        return Home(self.folder, record.id, None if record.out is None else Path(record.out))

    def all(self) -> list[Record]:
        """All runs, the newest first."""
        with self._lock:
            return sorted(self._records.values(), key=lambda one: one.created, reverse=True)

    def get(self, id: str) -> Record:
        """Find a run. Raises Refused."""
        with self._lock:
            if id not in self._records:
                raise not_there(f"{id[:100]}: there is no such run")
            return self._records[id]

    def progress(self, id: str) -> Progress:
        """What the events say of a run, up to now."""
        with self._lock:
            progress = self._progress[id]
            progress.update()
            return progress

    def news(self, id: str | None = None) -> tuple[int, ...]:
        """What changes with every change of a run, or of any run: cheap to ask for often."""
        with self._lock:
            followed = [key for key, one in self._records.items() if one.state == "running" and id in (None, key)]
            return self.version, *(self.progress(key).version for key in followed)

    def touch(self) -> None:
        """Note that something changed that pages show."""
        with self._lock:
            self.version += 1

    def plan(self, id: str) -> Plan:
        """The movies of a run. Raises MicrobundleError where its source is gone or wrong."""
        record = self.get(id)
        with self._lock:
            if id in self._plans:
                return self._plans[id]
        plan = self._planned(record)
        with self._lock:
            if self._records.get(id) == record:
                self._plans[id] = plan
        return plan

    def known_plan(self, id: str) -> Plan | None:
        """The movies of a run, where they were looked for already."""
        with self._lock:
            return self._plans.get(id)

    def open(self, at: str, *, new: bool = False) -> Record:
        """Find the run of a place, or make a draft of one. Raises Refused, and MicrobundleError where no movie is."""
        path = self.places.path(at)
        kind = kind_of(path, LOOKED_AT) if path.is_dir() else "movie"
        if kind == "batch":
            return self._open_written(path)
        if kind == "result":
            raise Refused(400, "Result", f"{path.name}: this is the result of one movie; its report.html opens in any "
                          "browser. Open the movie itself to change its masks or beats here")
        if not new:
            with self._lock:
                known = [one for one in self._records.values() if one.source == str(path)]
            if known:
                return max(known, key=lambda one: one.created)
        record = self._draft(path.name, path)
        plan = self._planned(record)
        with self._lock:
            self._plans[record.id] = plan
            return self._keep(replace(record, count=len(plan.tasks)), must=True)

    def _open_written(self, out: Path) -> Record:
        """Find the run of a folder that microbundle batch wrote, or take that on as it is.

        Raises Refused for links out of it, ResultUnreadable where it does not say how it was made.
        """
        self.places.check_results(out)
        with self._lock:
            known = [one for one in self._records.values() if self._home(one).out == out]
            if known:
                return known[0]
            recipe, under_way = read_recipe(out), _held(out)
            record = replace(
                self._draft(out.name, Path(recipe.source)), out=str(out), settings=recipe.settings,
                pattern=recipe.pattern, report=recipe.report, wells=recipe.wells,
                **{name: getattr(recipe, name) for name in EXTRAS},
                state="stopped" if under_way or not (out / MOVIES).is_file() else "done",
                message="A terminal is measuring into this folder." if under_way else "",
                count=sum(file.suffix == ".json" for file in (out / STATUS).iterdir()))
            return self._keep(record, must=True)

    def open_example(self, wells: int) -> Record:
        """Find the run of the example plate, or render that first, in the background."""
        path = self.places.workspace / EXAMPLE / f"plate_{wells}" / "plate.csv"
        with self._lock:
            known = [one for one in self._records.values() if one.source == str(path)]
            if known:
                return max(known, key=lambda one: one.created)
            record = replace(self._draft(f"Example plate, {wells} wells", path), state="preparing", wells=wells)
            self._keep(record, must=True)
        self._prepare(record)
        return record

    def change(self, id: str, wanted: dict[str, Any]) -> Record:
        """Change what a run is called, or how it measures. Raises Refused while it runs, ConfigError for wrong
        settings or a wrong pattern."""
        for name, value in wanted.items():
            if name not in CHANGED or not isinstance(value, CHANGED[name]):
                raise Refused(400, "BadRequest", f"{name[:50]}: expected one of {', '.join(CHANGED)}, of its own kind")
        if "title" in wanted:
            wanted["title"] = wanted["title"].strip()[:200] or "Run"
        if "settings" in wanted:
            Config.from_dict(wanted["settings"], source="settings")
        if "pattern" in wanted:
            wanted["pattern"] = (wanted["pattern"] or "").strip() or None
        record = self.get(id)
        if set(wanted) - {"title"} and record.state in ACTIVE:
            raise Refused(409, "Busy", "this run is under way; cancel it, or wait for it, before you change it")
        plan = self._planned(replace(record, **wanted)) if set(wanted) & {"settings", "pattern"} else None
        with self._lock:
            if self.get(id) != record:
                raise Refused(409, "Changed", "this run was changed in another window meanwhile; look at it again")
            record = self._keep(replace(record, **wanted, count=record.count if plan is None else len(plan.tasks)),
                                must=True)
            if plan is not None:
                self._plans[id] = plan
            return record

    def start(self, id: str) -> Record:
        """Put a run into the queue. Raises MicrobundleError where its plan is wrong, OutputError on a full disk."""
        record = self.get(id)
        if record.state in ACTIVE:
            raise Refused(409, "Busy", "this run is under way, or waits for its turn, already")
        plan = self._planned(record)
        with self._lock:
            self._plans[id] = plan
            if self.get(id).state in ACTIVE:
                raise Refused(409, "Busy", "this run is under way, or waits for its turn, already")
            self._keep(replace(record, state="queued", queued=now(), started=None, ended=None, message="", code=None,
                               pid=None, cancelled=False, count=len(plan.tasks)), must=True)
        self.look()
        return self.get(id)

    def cancel(self, id: str) -> Record:
        """Take a run out of the queue, or ask its process to stop; what is done is kept."""
        with self._lock:
            record = self.get(id)
            if record.state == "queued":
                return self._keep(replace(record, state="stopped" if self.home(id).out.exists() else "draft",
                                          message="Taken out of the queue before it began."))
            if record.state != "running":
                raise Refused(409, "NotRunning", "this run does not run, so there is nothing to cancel")
            record = self._keep(replace(record, cancelled=True, message="Stopping."))
            if record.pid is not None:
                process.interrupt(record.pid)
            self._asked[id] = 0
            return record

    def remove(self, id: str) -> None:
        """Take a run off the list; results go into the trash folder of the workspace, and are not deleted. Those that a
        terminal wrote stay where they are."""
        with self._lock:
            record = self.get(id)
            if record.state in ACTIVE:
                raise Refused(409, "Busy", "this run is under way; cancel it before you remove it")
            home = self._home(record)
            if home.elsewhere is None and home.out.exists():
                into = self.trash / f"{id}-{now()[:19].replace(':', '')}"
                into.mkdir(parents=True)
                for path in (home.out, home.events, home.log, home.settings, home.record):
                    if path.exists():
                        shutil.move(path, into / path.name)
            else:
                for path in (home.record, home.events, home.log, home.settings):
                    path.unlink(missing_ok=True)
            del self._records[id], self._progress[id]
            self._plans.pop(id, None)
            self.version += 1

    def look(self) -> None:
        """See what became of the processes, and start the next run of the queue."""
        with self._lock:
            for record in [one for one in self._records.values() if one.state == "running"]:
                self._follow(record)
            if any(one.state == "running" for one in self._records.values()):
                return
            waiting = [one for one in self._records.values() if one.state == "queued"]
            if waiting:
                self._start_now(min(waiting, key=lambda one: one.queued or ""))

    def _follow(self, record: Record) -> None:
        home, child = self._home(record), self._children.get(record.id)
        code = child.poll() if child is not None else None
        if code is None and (child is not None or process.lives(home, record.pid) or _held(home.out)):
            if record.id in self._asked:
                self._asked[record.id] += 1
                if self._asked[record.id] == PATIENCE and record.pid is not None:
                    process.end(record.pid)
            return
        progress = self._progress[record.id]
        progress.update()
        how = process.ending(home, record, code, progress.completed)
        self._children.pop(record.id, None)
        self._asked.pop(record.id, None)
        self._keep(replace(record, state=how.state, message=how.message, ended=now(), code=code, pid=None))

    def _start_now(self, record: Record) -> None:
        home = self._home(record)
        try:
            if record.settings:
                with whole(home.settings) as stream:
                    stream.write(toml(record.settings))
            sizes = [file.stat().st_size if file.exists() else 0 for file in (home.events, home.log)]
            record = replace(record, events_from=sizes[0], log_from=sizes[1])
            child = process.launch(home, record)
        except (OSError, MicrobundleError) as error:
            self._keep(replace(record, state="failed", ended=now(), message=_reason(error)))
            return
        self._children[record.id] = child
        self._progress[record.id] = Progress(home.events, record.events_from)
        self._keep(replace(record, state="running", started=now(), pid=child.pid, message=""))

    def _draft(self, title: str, source: Path) -> Record:
        created = now()
        with self._lock:
            return Record(new_id(title, created, set(self._records)), title, str(source), created)

    def _planned(self, record: Record) -> Plan:
        """Plan a run, and check that all of its movies lie within the folders of this app."""
        config = Config.from_dict(dict(record.settings), source="settings")
        plan = make_plan(self.places.within(Path(record.source)), config=config, pattern=record.pattern,
                         report=record.report)
        for task in plan.tasks:
            self.places.within(task.path)
        return plan

    def _prepare(self, record: Record) -> None:
        """Render the example in the background; the run is a draft when it is there."""
        def work() -> None:
            try:
                render(Path(record.source).parent, record.wells or 24, told(record.id))
                done = replace(record, state="draft", count=len(self._planned(record).tasks))
            except Exception as error:
                if not isinstance(error, MicrobundleError | OSError | Refused):
                    log.exception("example")
                done = replace(record, state="failed", message=f"The example cannot be rendered: {_reason(error)}")
            with self._lock:
                self.preparing.pop(record.id, None)
                self._keep(done)

        def told(id: str) -> Callable[[float], None]:
            def tell(share: float) -> None:
                self.preparing[id] = share
                self.touch()

            return tell

        self.preparing[record.id] = 0.0
        threading.Thread(target=work, daemon=True, name=f"example {record.id}").start()

    def _keep(self, record: Record, *, must: bool = False) -> Record:
        """Write a record, and take it in. What became of a process is taken in even where the disk is full, for it can
        be found out again; what a person asks for (`must`) is not. Raises OSError for that."""
        try:
            write_record(self._home(record), record)
        except OSError as error:
            if must:
                raise
            log.warning("%s: the record cannot be written: %s", record.id, error)
        if record.id not in self._progress:
            self._progress[record.id] = Progress(self._home(record).events, record.events_from)
        self._records[record.id] = record
        self.version += 1
        return record

    def shown_command(self, id: str) -> str:
        """The command of a run, to paste into a terminal."""
        return command(self.home(id), self.get(id))


def _held(out: Path) -> bool:
    """Tell whether a process holds the folder of a run."""
    try:
        with (out / LOCK).open("r+" if os.name == "nt" else "r") as stream:
            return not hold(stream)
    except OSError:
        return False


def _reason(error: Exception) -> str:
    if isinstance(error, OSError):
        return f"{error.filename or 'disk'}: {error.strerror or error}"
    return str(error)
