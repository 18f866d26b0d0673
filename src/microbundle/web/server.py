"""Start the app: hold its workspace, take a port of this computer, open the browser, and serve until it is stopped.

A workspace belongs to one app at a time; starting a second one opens the page of the first. Port and token are kept in
the workspace, readable by its owner alone, so that pages that are still open go on after a restart. Runs go on in
processes of their own.
"""

from __future__ import annotations

import json
import logging
import os
import secrets
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import uvicorn

from ..batch.state import hold
from ..errors import ConfigError, OutputError
from ..folder import LIST
from .app import make_app
from .desk import Desk

KIND = "app"
ADDRESS = "127.0.0.1"
FIRST_PORT = 8765
"""Tried first, so that an address can be kept; any free one is taken where it is in use."""
KEPT, LOCK, LOG = ".microbundle_app.json", ".microbundle_app.lock", "app.log"
PATIENCE_S = 2
"""How long answers that are under way may take when the app is stopped."""


@dataclass(frozen=True)
class Door:
    """Where the app answers, and to whom."""

    port: int
    token: str

    @property
    def address(self) -> str:
        return f"http://{ADDRESS}:{self.port}/?token={self.token}"


def serve(folders: list[Path], workspace: Path, *, port: int | None = None, browser: bool = True,
          quiet: bool = False) -> int:
    """Serve the app until it is stopped; returns an exit code.

    Raises ConfigError for folders that are none or a port in use, OutputError for a workspace that is not ours.
    """
    workspace = workspace.expanduser().resolve()
    with held(workspace) as mine:
        if not mine:
            return _show_other(workspace, browser=browser, quiet=quiet)
        kept = read_door(workspace)
        listening = listen(port, kept)
        door = Door(listening.getsockname()[1], kept.token if kept else secrets.token_urlsafe(32))
        with listening, _logged(workspace):
            write_door(workspace, door)
            desk = Desk(folders, workspace)
            server = Server(desk, door)
            if not quiet:
                print(f"microbundle app: {door.address}\nfolder of its results: {workspace}\nstop it with Ctrl-C; runs "
                      "that have begun go on without it", flush=True)
            if browser:
                threading.Thread(target=_open_browser, args=(server, door), daemon=True).start()
            with suppress(KeyboardInterrupt):  # that is how an app is stopped
                server.run(sockets=[listening])
    return 0


class Server(uvicorn.Server):
    """The server of one app; open streams end when it is to stop."""

    def __init__(self, desk: Desk, door: Door) -> None:
        super().__init__(uvicorn.Config(
            make_app(desk, token=door.token, port=door.port), log_config=None, access_log=False, server_header=False,
            proxy_headers=False, lifespan="on", ws="none", timeout_graceful_shutdown=PATIENCE_S))
        self.desk = desk

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        self.desk.stopping = True
        super().handle_exit(sig, frame)


def listen(port: int | None, kept: Door | None) -> socket.socket:
    """Take a port of this computer: the one asked for, or the one of last time, or any. Raises ConfigError."""
    if port is not None and not 0 <= port < 65536:
        raise ConfigError(f"--port: expected a number from 0 to 65535; found {port}")
    wanted = [port] if port is not None else [*([kept.port] if kept else []), FIRST_PORT, 0]
    for number in wanted:
        listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        if os.name == "posix":
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((ADDRESS, number))
            listening.listen(128)
            return listening
        except OSError as error:
            listening.close()
            reason = error.strerror or error
    raise ConfigError(f"--port {port}: expected a free port; it cannot be taken: {reason}")


@contextmanager
def held(workspace: Path) -> Iterator[bool]:
    """Hold a workspace for this app; False where another app holds it. Raises OutputError."""
    try:
        check_ours(workspace)
        workspace.mkdir(parents=True, exist_ok=True)
        if not (workspace / LIST).exists():
            (workspace / LIST).write_text(json.dumps({"kind": KIND, "files": []}) + "\n", encoding="utf-8")
        stream = (workspace / LOCK).open("a")
    except OSError as error:
        raise OutputError(f"{workspace}: the folder cannot be written: {error.strerror or error}") from None
    with stream:
        yield hold(stream)


def check_ours(workspace: Path) -> None:
    """Check that a folder may be a workspace: new, empty, or ours. Raises OutputError."""
    if not workspace.exists():
        return
    if not workspace.is_dir():
        raise OutputError(f"{workspace}: expected a folder for the app's results; there is a file of that name")
    kind = ""
    with suppress(OSError, ValueError, TypeError, KeyError):
        kind = json.loads((workspace / LIST).read_text(encoding="utf-8"))["kind"]
    others = sorted(name for name in os.listdir(workspace) if not name.startswith("."))
    if kind != KIND and others:
        raise OutputError(f"{workspace}: expected a new or empty folder, or one of an earlier app; it holds something "
                          f"else, such as {others[0]}. Choose another with --workspace")


def read_door(workspace: Path) -> Door | None:
    """Read where the last app of a workspace answered; None where there was none."""
    try:
        kept: dict[str, Any] = json.loads((workspace / KEPT).read_text(encoding="utf-8"))
        door = Door(int(kept["port"]), str(kept["token"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return door if len(door.token) >= 32 and 0 < door.port < 65536 else None


def write_door(workspace: Path, door: Door) -> None:
    """Keep where this app answers, for its owner alone. Raises OutputError."""
    partial = workspace / f"{KEPT}.partial"
    try:
        partial.unlink(missing_ok=True)
        with open(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as stream:
            json.dump(asdict(door), stream)
        partial.replace(workspace / KEPT)
    except OSError as error:
        raise OutputError(f"{workspace}: the folder cannot be written: {error.strerror or error}") from None


def _show_other(workspace: Path, *, browser: bool, quiet: bool) -> int:
    """Open the page of the app that holds the workspace already."""
    door = read_door(workspace)
    if door is None:
        raise OutputError(f"{workspace}: another app works here and has not begun to answer; try again in a moment")
    if not quiet:
        print(f"microbundle app: runs already for this folder: {door.address}", flush=True)
    if browser:
        _open(door.address)
    return 0


def _open_browser(server: Server, door: Door) -> None:
    """Open the browser once the server answers."""
    import time

    while not server.started and not server.should_exit:
        time.sleep(0.05)
    if server.started:
        _open(door.address)


def _open(address: str) -> None:
    import webbrowser

    with suppress(webbrowser.Error):
        if not webbrowser.open(address):
            print("open this address in a browser", file=sys.stderr)


@contextmanager
def _logged(workspace: Path) -> Iterator[None]:
    """Keep what goes wrong within the app in a file of its workspace."""
    handler = logging.FileHandler(workspace / LOG, delay=True, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(name)s %(levelname)s %(message)s"))
    loggers = [logging.getLogger("microbundle.web"), logging.getLogger("uvicorn")]
    for logger in loggers:
        logger.addHandler(handler)
        logger.setLevel(logging.WARNING)
        logger.propagate = False
    try:
        yield
    finally:
        for logger in loggers:
            logger.removeHandler(handler)
        handler.close()
