"""Run the pipeline over validation movies as a user runs it, and score it against their truth.

    rows = run_validation(case_set("frontier"), Config(), folder)

The pipeline gets the movie alone: it finds the tissue, the beats and everything else by itself. Every finished case
is one line of `scores.jsonl` in the folder, with its traces in `traces/`; a case whose movie, settings and program
are unchanged is not run again, so an interrupted run goes on where it stopped. A movie that cannot be measured is a
row that says why.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.metadata import version
from itertools import groupby
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any

import numpy as np

from ..analysis import Analysis
from ..config import Config
from ..data import Floats
from ..errors import MicrobundleError, OutputError
from ..pipeline import analyze
from .cases import Case
from .coverage import coverage
from .render import SyntheticMovie
from .scores import Comparison, Scores, compare, score

LEDGER = "scores.jsonl"
TRACES = "traces"
MEASURED = "measured"
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Row:
    """One scored movie."""

    case: str
    group: str
    key: str
    """Fingerprint of movie, settings and program."""
    status: str
    """`measured`, `no beats: why` where the result says so itself, or `failed: why`."""
    verdict: str = "fail"
    seconds: float = np.nan
    """Processor time of the analysis; drawing and scoring come on top."""
    drawing_seconds: float = np.nan
    scores: Mapping[str, float] = field(default_factory=lambda: Scores().as_dict())
    held: Mapping[str, Sequence[float]] = field(default_factory=dict)
    """By quantity: share of intervals that hold the truth, at each of the levels in `coverage`."""

    @property
    def measured(self) -> bool:
        return self.status == MEASURED

    def as_json(self) -> str:
        """One line; what is not a number is null."""
        def plain(value: Any) -> Any:
            return None if isinstance(value, float) and not np.isfinite(value) else value

        content = vars(self) | {"scores": {k: plain(v) for k, v in self.scores.items()}}
        return json.dumps({k: plain(v) for k, v in content.items()})

    @classmethod
    def from_json(cls, line: str) -> Row:
        """Read a line back. Raises ValueError, KeyError or TypeError for anything else."""
        content = json.loads(line)
        content["scores"] = {k: np.nan if v is None else float(v) for k, v in content["scores"].items()}
        for name in ("seconds", "drawing_seconds"):
            content[name] = np.nan if content[name] is None else content[name]
        return cls(**content)


Tell = Callable[[Row, int, int], None]
"""Hears each row as it is there, the number of rows done and of all."""


def run_validation(cases: Sequence[Case], config: Config, folder: Path | str, *, workers: int = 1,
                   tell: Tell | None = None) -> list[Row]:
    """Score the pipeline on cases, and give their rows in the order of the cases.

    `folder` is new, empty, or holds an earlier validation, whose rows are kept and used where nothing has changed.
    Raises OutputError for another folder, or one that cannot be written.
    """
    folder = Path(folder)
    open_folder(folder)
    wanted = {case.name: row_key(case, config) for case in cases}
    done = {row.case: row for row in read_ledger(folder) if wanted.get(row.case) == row.key}
    open_cases = [case for case in cases if case.name not in done]
    for case in {c.scene_key: c for c in open_cases}.values():
        case.scene.prepare()

    def finished(row: Row) -> None:
        done[row.case] = row
        append(folder, row)
        if tell is not None:
            tell(row, len(done), len(cases))

    batches = _batches(open_cases, workers)
    if workers <= 1 or len(batches) <= 1:
        for batch in batches:
            for row in run_batch(batch, config, folder, wanted):
                finished(row)
    else:
        with _single_threaded(), ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            try:
                for future in as_completed([pool.submit(_listed, batch, config, folder, wanted) for batch in batches]):
                    for row in future.result():
                        finished(row)
            except BrokenProcessPool:
                raise MicrobundleError("a worker ended before its movie was scored, perhaps for want of memory; start "
                                       "again with fewer --workers, finished movies are kept") from None
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    return [done[case.name] for case in cases]


def run_batch(cases: Sequence[Case], config: Config, folder: Path, keys: Mapping[str, str]) -> Iterator[Row]:
    """Score cases that show the same scene: its clean frames are drawn once, and each case adds its noise."""
    clean: Floats | None = None
    for case in cases:
        start = time.process_time()
        synthetic = case.make()
        if len(cases) > 1 and clean is None:
            clean = np.stack([synthetic.rendered.perfect(t).astype(np.float32) for t in range(synthetic.movie.count)])
        yield run_case(case, config, folder, synthetic.drawn(clean), keys[case.name], time.process_time() - start)


def run_case(case: Case, config: Config, folder: Path, shown: SyntheticMovie, key: str,
             drawing_seconds: float = np.nan) -> Row:
    """Analyze and score one drawn movie, and keep its traces; a movie that cannot be measured gives a row, no error."""
    start = time.process_time()
    row = Row(case.name, case.group, key, "", drawing_seconds=drawing_seconds)
    try:
        analysis = analyze(shown.movie, config)
        row = replace(row, seconds=time.process_time() - start, verdict=analysis.verdict)
        comparison = compare(shown, analysis, case.domain)
    except MicrobundleError as error:
        return replace(row, seconds=time.process_time() - start, status=f"failed: {type(error).__name__}: {error}")
    save_traces(folder / TRACES / f"{case.name}.npz", comparison)
    return replace(row, status=status_of(analysis, comparison), scores=score(comparison).as_dict(),
                   held=coverage(shown, analysis, comparison))


def status_of(analysis: Analysis, comparison: Comparison) -> str:
    """Say whether a result has something to score, and if not, what the result says of itself."""
    if len(comparison.pairs) or not len(comparison.beats):
        return MEASURED
    why = next((f.message for f in analysis.findings if f.level == "fail"), "no beat where there is one")
    return f"no beats: {why}"


def row_key(case: Case, config: Config) -> str:
    """Fingerprint of a case, the settings and the program."""
    return hashlib.sha256(f"{case.key} {config.model_dump_json()} {program()}".encode()).hexdigest()[:24]


@lru_cache(maxsize=1)
def program() -> str:
    """Version of microbundle and a hash of its source, so that an edited program is scored anew."""
    here = Path(__file__).parent
    files = [*sorted(here.parent.glob("*.py")), *sorted(here.glob("*.py"))]
    total = hashlib.sha256(b"".join(f.read_bytes() for f in files if f.name not in NO_INFLUENCE))
    return f"{version('microbundle')} {total.hexdigest()[:16]}"


NO_INFLUENCE = ("cli.py", "commands.py", "store.py", "paper_layout.py", "demo.py", "validation_tables.py",
                "validation_figures.py", "manual.py", "simulate.py", "microscope.py")
"""Files that change no score."""


def open_folder(folder: Path) -> None:
    """Make the folder of a validation, or check that it is one. Raises OutputError."""
    try:
        if folder.is_dir() and any(folder.iterdir()) and not (folder / LEDGER).is_file():
            raise OutputError(f"{folder}: expected a new or empty folder, or that of an earlier validation; it holds "
                              "other files. Choose another with --out")
        (folder / TRACES).mkdir(parents=True, exist_ok=True)
        ledger = folder / LEDGER
        ledger.touch()
        text = ledger.read_bytes()
        if text and not text.endswith(b"\n"):  # the last run was stopped in the middle of a line
            with ledger.open("ab") as file:
                file.write(b"\n")
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror or error}") from None


def read_ledger(folder: Path) -> Iterator[Row]:
    """Read the rows of a validation folder, oldest first; lines that a stopped run left unfinished are passed over."""
    for line in (folder / LEDGER).read_text(encoding="utf-8").splitlines():
        try:
            yield Row.from_json(line)
        except (ValueError, KeyError, TypeError):
            continue


def append(folder: Path, row: Row) -> None:
    """Add a row to the ledger, and see that it is on the disk."""
    try:
        with (folder / LEDGER).open("a", encoding="utf-8") as file:
            file.write(row.as_json() + "\n")
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise OutputError(f"{folder / LEDGER}: cannot be written: {error.strerror or error}") from None


def save_traces(file: Path, c: Comparison) -> None:
    """Keep the curves of a case, true and measured, for its figures."""
    part = file.with_suffix(".part")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with part.open("wb") as stream:
            np.savez_compressed(
                stream, mad_true_px=c.mad[0], mad_found_px=c.mad[1], ecc_true=c.ecc[0], ecc_found=c.ecc[1],
                start=c.beats.start, peak=c.beats.peak, stop=c.beats.stop)
        os.replace(part, file)
    except OSError as error:
        raise OutputError(f"{file}: cannot be written: {error.strerror or error}") from None


def _batches(cases: Sequence[Case], workers: int) -> list[list[Case]]:
    """Put cases with the same scene together, but in pieces small enough to keep all workers busy."""
    size = max(1, min(9, -(-len(cases) // max(2 * workers, 1))))
    out = []
    for _, same in groupby(sorted(cases, key=lambda c: c.scene_key), key=lambda c: c.scene_key):
        together = list(same)
        out += [together[i:i + size] for i in range(0, len(together), size)]
    order = {case.name: i for i, case in enumerate(cases)}
    return sorted(out, key=lambda batch: order[batch[0].name])


def _listed(batch: Sequence[Case], config: Config, folder: Path, keys: Mapping[str, str]) -> list[Row]:
    import cv2

    cv2.setNumThreads(1)
    rows = []
    for row in run_batch(batch, config, folder, keys):
        rows.append(row)
        parent = parent_process()
        if parent is not None and not parent.is_alive():  # killed: nobody will ever hear of the rest
            os._exit(1)
    return rows


@contextmanager
def _single_threaded() -> Iterator[None]:
    """Let worker processes start with one thread each; the caller's own environment comes back afterwards."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
