"""What is dropped on the page: written as it comes, below a new folder of the workspace, whole or not at all.

A dropped folder keeps the names of its files. Names come from another computer, perhaps: what a file system takes for a
place, a device or a command is taken out of them.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import anyio.to_thread
from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.requests import ClientDisconnect, Request

from ..errors import OutputError
from .answers import Refused
from .desk import Desk
from .places import UPLOADS
from .records import now
from .results import check_room

LONGEST = 120
"""Letters of a name that are kept."""
DEEPEST = 12
MOST_FILES = 50_000
SPARE = 50 * 10**6
"""Bytes that stay free on the disk."""
DEVICES = re.compile(r"(?:con|prn|aux|nul|com\d|lpt\d)(?:\..*)?", re.IGNORECASE)


async def receive(desk: Desk, request: Request) -> dict[str, Any]:
    """Take in what was dropped; gives its place. Raises Refused for what is no upload, OutputError on a full disk."""
    kind, options = parse_options_header(request.headers.get("content-type", ""))
    boundary = options.get(b"boundary", b"")
    if kind != b"multipart/form-data" or not boundary:
        raise Refused(400, "BadRequest", "expected files, as multipart/form-data")
    home = desk.workspace / UPLOADS
    async with desk.limits["uploads"]:
        into = await anyio.to_thread.run_sync(_begin, home, int(request.headers.get("content-length", 0)))
        try:
            incoming = Incoming(into, boundary)
            async for chunk in request.stream():
                await anyio.to_thread.run_sync(incoming.write, chunk)
            name = await anyio.to_thread.run_sync(incoming.finish, home)
        except ClientDisconnect:
            raise Refused(400, "BadRequest", "the upload ended before it was complete") from None
        finally:
            with anyio.CancelScope(shield=True):
                await anyio.to_thread.run_sync(lambda: shutil.rmtree(into, ignore_errors=True))
    return {"at": f"{UPLOADS}/{name}", "files": incoming.count}


def _begin(home: Path, announced: int) -> Path:
    home.mkdir(parents=True, exist_ok=True)
    check_room(home, announced + SPARE)
    return Path(tempfile.mkdtemp(prefix=".upload.partial-", dir=home))


class Incoming:
    """Files that are being received into a folder."""

    def __init__(self, folder: Path, boundary: bytes) -> None:
        self.folder, self.count = folder, 0
        self._header, self._value, self._about = b"", b"", dict[str, bytes]()
        self._stream: IO[bytes] | None = None
        self._parser = MultipartParser(boundary, {
            "on_part_begin": self._part_begin, "on_part_data": self._part_data, "on_part_end": self._part_end,
            "on_header_field": self._header_field, "on_header_value": self._header_value,
            "on_header_end": self._header_end, "on_headers_finished": self._headers_finished, "on_end": self._end})
        self._complete = False

    def write(self, chunk: bytes) -> None:
        """Take in what came. Raises Refused and OutputError."""
        try:
            if chunk:
                self._parser.write(chunk)
        except FormParserError as error:
            raise Refused(400, "BadRequest", f"expected files, as multipart/form-data: {error}") from None
        except OSError as error:
            raise OutputError(f"{self.folder.parent}: the dropped files cannot be written: {error.strerror or error}"
                              ) from None

    def finish(self, home: Path) -> str:
        """Give the files their place, and its name. Raises Refused where nothing, or not all of it, came."""
        self._part_end()
        if not self._complete:
            raise Refused(400, "BadRequest", "the upload ended before it was complete")
        tops = sorted(self.folder.iterdir())
        if not tops:
            raise Refused(400, "BadRequest", "expected at least one file; none came")
        if len(tops) == 1 and tops[0].is_dir():
            source, wanted = tops[0], tops[0].name
        else:
            source, wanted = self.folder, tops[0].stem if len(tops) == 1 else f"dropped_{now()[:10]}"
        self.folder.chmod(0o755)
        for attempt in range(1, 10_000):
            target = home / (wanted if attempt == 1 else f"{wanted}_{attempt}")
            if not target.exists():
                with suppress(OSError):  # another upload was faster
                    source.rename(target)
                    return target.name
        raise OutputError(f"{home}: there are too many uploads of the name {wanted}")

    def _part_begin(self) -> None:
        self._about = {}

    def _header_field(self, data: bytes, start: int, end: int) -> None:
        self._header += data[start:end]

    def _header_value(self, data: bytes, start: int, end: int) -> None:
        self._value += data[start:end]

    def _header_end(self) -> None:
        self._about[self._header.decode("latin-1").lower()] = self._value
        self._header = self._value = b""

    def _headers_finished(self) -> None:
        _, options = parse_options_header(self._about.get("content-disposition", b""))
        named = options.get(b"filename")
        if named is None:
            return
        file = self.folder.joinpath(*safe_parts(named.decode("utf-8", "replace")))
        self.count += 1
        if self.count > MOST_FILES:
            raise Refused(413, "TooLarge", f"expected at most {MOST_FILES} files at once; found more")
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            self._stream = file.open("xb")
        except (FileExistsError, NotADirectoryError):
            raise Refused(400, "BadRequest", f"{file.name}: expected each file once; it came twice") from None

    def _part_data(self, data: bytes, start: int, end: int) -> None:
        if self._stream is not None:
            self._stream.write(data[start:end])

    def _part_end(self) -> None:
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    def _end(self) -> None:
        self._complete = True


def safe_parts(name: str) -> list[str]:
    """Cut the name of a dropped file into the names of folders and a file that are safe on any system."""
    parts = [_safe(part) for part in re.split(r"[/\\]", name) if part not in ("", ".", "..")]
    return parts[-DEEPEST:] or ["file"]


def _safe(part: str) -> str:
    plain = re.sub(r'[\x00-\x1f\x7f<>:"|?*]', "_", part).encode("utf-8", "replace").decode()
    plain = plain.strip(" ").rstrip(".").lstrip(".") or "file"
    if len(plain) > LONGEST:
        stem, dot, suffix = plain.rpartition(".")
        plain = f"{stem[:LONGEST - 10]}{dot}{suffix}" if dot and len(suffix) < 8 else plain[:LONGEST]
    return f"_{plain}" if DEVICES.fullmatch(plain) else plain
