"""Everything of a run as a ZIP, written as it is sent: neither memory nor disk hold more than a piece of it."""

from __future__ import annotations

import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, cast

from starlette.concurrency import iterate_in_threadpool
from starlette.responses import StreamingResponse

from ..batch.state import RESULTS, STATUS
from .answers import not_there
from .desk import Desk
from .records import Home

PIECE = 256 * 1024
PACKED = (".nc", ".png", ".jpg", ".mp4", ".gif", ".pdf", ".xlsx", ".parquet", ".h5")
"""Files that compression makes no smaller."""
COMMAND = "command.txt"


class _Sink:
    """A file that is only written, and gives away what was written to it."""

    def __init__(self) -> None:
        self.pieces: list[bytes] = []
        self.at = 0

    def write(self, data: bytes) -> int:
        self.pieces.append(bytes(data))
        self.at += len(data)
        return len(data)

    def tell(self) -> int:
        return self.at

    def flush(self) -> None:
        """Nothing waits here."""

    def taken(self) -> bytes:
        out, self.pieces = b"".join(self.pieces), []
        return out


def zip_of(desk: Desk, id: str, movies: str) -> StreamingResponse:
    """Send the files of a run; `movies` are the keys of those wanted, with commas between, or "all". Raises Refused."""
    record, home = desk.runs.get(id), desk.runs.home(id)
    keys = None if movies == "all" else [key for key in movies.split(",") if key]
    if not home.out.is_dir():
        raise not_there("this run has written nothing yet; start it first")
    if keys is not None:
        for key in keys:
            desk.views.task(id, key)
    about = (f"{record.title}\n\nMade by this command, which makes the same again:\n\n"
             f"{desk.runs.shown_command(id)}\n")
    stream = iterate_in_threadpool(pieces(home, keys, about))
    return StreamingResponse(stream, media_type="application/zip",
                             headers={"content-disposition": f'attachment; filename="{id}.zip"'})


def pieces(home: Home, keys: list[str] | None, about: str) -> Iterator[bytes]:
    """Give the archive piece by piece."""
    sink = _Sink()
    with zipfile.ZipFile(cast(IO[bytes], sink), "w") as archive:
        archive.writestr(_entry(f"{home.id}/{COMMAND}", time.time(), zipfile.ZIP_DEFLATED), about)
        for file in wanted(home, keys):
            name = f"{home.id}/{file.name if file == home.settings else file.relative_to(home.out).as_posix()}"
            try:
                with file.open("rb") as stream:
                    how = zipfile.ZIP_STORED if file.suffix.lower() in PACKED else zipfile.ZIP_DEFLATED
                    with archive.open(_entry(name, file.stat().st_mtime, how), "w", force_zip64=True) as into:
                        while piece := stream.read(PIECE):
                            into.write(piece)
                            yield sink.taken()
            except FileNotFoundError:  # a run that goes on has just replaced it
                continue
            yield sink.taken()
    yield sink.taken()


def wanted(home: Home, keys: list[str] | None) -> Iterator[Path]:
    """The files of a run that go into the archive: no hidden ones, and nothing that a link leads to."""
    if home.settings.is_file():
        yield home.settings
    for file in sorted(home.out.rglob("*")):
        parts = file.relative_to(home.out).parts
        if any(part.startswith(".") for part in parts) or file.is_symlink() or not file.is_file():
            continue
        if keys is not None and parts[0] == STATUS:
            continue
        if keys is not None and parts[0] == RESULTS and not any(
                parts[1] == key or (parts[1].startswith(f"{key}.") and len(parts) == 2) for key in keys):
            continue
        yield file


def _entry(name: str, changed: float, how: int) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, time.localtime(max(changed, 315_622_800))[:6])
    entry.compress_type = how
    entry.external_attr = 0o644 << 16
    return entry
