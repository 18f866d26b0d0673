"""The app in this process, as its pages see it, and as a server of its own where processes matter."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

pytest.importorskip("starlette", reason="the extra web is not installed")

from starlette.testclient import TestClient

from microbundle.web.app import make_app
from microbundle.web.desk import Desk

from ..conftest import write_frames

Image = NDArray[Any]
TOKEN, PORT = "t" * 43, 8765
ORIGIN = f"http://127.0.0.1:{PORT}"
FAST = {"method": "fast", "fps": 30, "um_per_px": 4, "strain": {"tile_px": 20}}
PATIENCE_S = 120.0
"""For processes, on a machine under load."""


@pytest.fixture(scope="session", autouse=True)
def one_processor() -> Iterator[None]:
    """Keep to one processor, so that each run has one worker and starts in half the time."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {sorted(allowed)[os.getpid() % len(allowed)]})
    yield
    os.sched_setaffinity(0, allowed)


@pytest.fixture(scope="session")
def movies(small: Image, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two movies, one as a file and one as a folder of frames, and one that is damaged."""
    folder = tmp_path_factory.mktemp("app") / "plate1"
    folder.mkdir()
    tifffile.imwrite(folder / "P_A1.tif", small)
    write_frames(small, folder / "P_B2")
    (folder / "P_B3.tif").write_bytes(b"II*\0 no movie")
    return folder


Opened = Callable[..., TestClient]


@pytest.fixture
def open_app(tmp_path: Path) -> Iterator[Opened]:
    """Make an app over folders, with its runs looked after, and a client that has the token."""
    opened: list[TestClient] = []

    def make(*folders: Path, workspace: Path | None = None, **options: Any) -> TestClient:
        workspace = workspace or tmp_path / "workspace"
        workspace.mkdir(exist_ok=True)
        client = client_of(Desk(list(folders), workspace), **options)
        client.__enter__()
        opened.append(client)
        return client

    yield make
    for client in opened:
        client.__exit__(None, None, None)


def client_of(desk: Desk, **options: Any) -> TestClient:
    """A client of an app, that has the token and the header of the app's own pages."""
    client = TestClient(make_app(desk, token=TOKEN, port=PORT, **options), base_url=ORIGIN, follow_redirects=False)
    client.cookies.set(f"microbundle_{PORT}", TOKEN)
    client.headers["X-Microbundle"] = "1"
    client.desk = desk  # type: ignore[attr-defined]
    return client


def run_of(client: TestClient, at: str, **settings: Any) -> str:
    """Open a place, and set its run."""
    id = said(client.post("/api/open", json={"at": at}))["run"]
    said(client.patch(f"/api/runs/{id}", json={"settings": FAST | settings}))
    return str(id)


def said(answer: Any) -> Any:
    """The content of an answer, which must be a good one."""
    assert answer.status_code == 200, answer.text
    return answer.json()


def ended(client: Any, id: str) -> dict[str, Any]:
    """Wait until a run has ended."""
    return until(lambda: view if (view := said(client.get(f"/api/runs/{id}")))["state"] not in (
        "queued", "running", "preparing") else None)


def until(look: Callable[[], Any], patience_s: float = PATIENCE_S) -> Any:
    """Look again and again until there is something."""
    stop = time.monotonic() + patience_s
    while time.monotonic() < stop:
        found = look()
        if found:
            return found
        time.sleep(0.1)
    raise AssertionError("it did not happen")


class Server:
    """A server in a process of its own."""

    def __init__(self, folder: Path, workspace: Path, *, limit: Callable[[], None] | None = None) -> None:
        command = [sys.executable, "-m", "microbundle", "app", str(folder), "--workspace", str(workspace),
                   "--no-browser", "--port", "0"]
        if (workspace / ".microbundle_app.json").exists():
            command = command[:-2]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                                        preexec_fn=limit, env=os.environ | {"PYTHONUNBUFFERED": "1"})
        assert self.process.stdout is not None
        self.address = self.process.stdout.readline().split(": ", 1)[-1].strip()
        assert self.address.startswith("http://127.0.0.1:"), self.process.communicate()
        base = self.address.partition("/?")[0]
        self.client = httpx.Client(base_url=base, headers={"X-Microbundle": "1"}, timeout=60)
        until(self._answers)
        assert self.client.get(self.address).status_code == 303
        self.kept = json.loads((workspace / ".microbundle_app.json").read_text())

    def _answers(self) -> bool:
        try:
            return self.client.get("/").status_code == 401
        except httpx.TransportError:
            return False

    def stop(self, how: int = signal.SIGINT) -> int:
        self.client.close()
        self.process.send_signal(how)
        return self.process.wait(30)


@pytest.fixture
def serve() -> Iterator[Callable[..., Server]]:
    """Start servers, which are ended with the test."""
    started: list[Server] = []

    def make(*arguments: Any, **named: Any) -> Server:
        started.append(Server(*arguments, **named))
        return started[-1]

    yield make
    for server in started:
        if server.process.poll() is None:
            server.stop(signal.SIGKILL)


@pytest.fixture(scope="session")
def measured(movies: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[TestClient, str]]:
    """An app whose run over the movies is done, and the run."""
    workspace = tmp_path_factory.mktemp("measured")
    with client_of(Desk([movies], workspace)) as client:
        id = run_of(client, "plate1")
        said(client.patch(f"/api/runs/{id}", json={"pattern": "{plate}_{well}"}))
        said(client.post(f"/api/runs/{id}/start", json={}))
        assert ended(client, id)["state"] == "done"
        yield client, id


def mask_png(mask: Image) -> str:
    """A drawing of a mask, as a page sends it: white where it is in, four channels."""
    import base64

    import cv2

    drawn = np.dstack([np.where(mask, 255, 0)] * 3 + [np.full(mask.shape, 255)]).astype(np.uint8)
    return "data:image/png;base64," + base64.b64encode(cv2.imencode(".png", drawn)[1].tobytes()).decode()
