"""The command and its server: one app for a workspace, on this computer alone, found again at the same address."""

from __future__ import annotations

import json
import os
import shlex
import signal
import socket
import stat
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from microbundle import cli
from microbundle.batch.find import find_movies
from microbundle.errors import ConfigError
from microbundle.web.server import Door, listen, read_door

from .conftest import Server, said, until

Serve = Callable[..., Server]
Captured = pytest.CaptureFixture[str]


def test_one_app_for_a_workspace_and_everything_in_its_place(serve: Serve, movies: Path) -> None:
    workspace = movies.parent / "workspace"
    server = serve(movies.parent, workspace)
    assert stat.S_IMODE((workspace / ".microbundle_app.json").stat().st_mode) == 0o600
    port, token = server.kept["port"], server.kept["token"]
    assert len(token) >= 43
    assert server.address == f"http://127.0.0.1:{port}/?token={token}"
    assert token not in server.client.get("/").text

    second = subprocess.run([sys.executable, "-m", "microbundle", "app", str(movies), "--workspace", str(workspace),
                             "--no-browser"], capture_output=True, text=True, timeout=60, check=False)
    assert (second.returncode, server.address in second.stdout) == (0, True)

    names = [one["name"] for one in said(server.client.get("/api/browse?at=" + movies.parent.name.lower()))["entries"]]
    assert "workspace" not in names
    assert not [name for name, _ in find_movies(movies.parent) if "workspace" in name]
    with server.client.stream("GET", "/api/events") as stream:
        lines = stream.iter_lines()
        assert next(lines) == "event: runs"
        server.process.send_signal(signal.SIGINT)
        list(lines)  # it ends when the app does
    assert server.process.wait(30) == 0
    assert not (workspace / "app.log").exists()


def test_only_this_computer_can_connect(serve: Serve, movies: Path, tmp_path: Path) -> None:
    server = serve(movies, tmp_path / "ws")
    others = {address[4][0] for address in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)
              if not str(address[4][0]).startswith("127.")}
    for address in others:
        with pytest.raises(OSError, match=r"."), socket.create_connection((address, server.kept["port"]), 2):
            pass
    listening = Path("/proc/net/tcp")
    if listening.exists():
        wanted = f":{server.kept['port']:04X}"
        local = {line.split()[1] for line in listening.read_text().splitlines()[1:] if line.split()[3] == "0A"}
        assert {one for one in local if one.endswith(wanted)} == {f"0100007F{wanted}"}


def test_a_port_in_use_is_told_or_another_taken(movies: Path, tmp_path: Path, capsys: Captured) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert cli.run(["app", str(movies), "--workspace", str(tmp_path / "ws"), "--port", str(port)]) == 2
        assert f"--port {port}: expected a free port" in capsys.readouterr().err
        with listen(None, Door(port, "t" * 43)) as other:
            assert other.getsockname()[1] != port
    for wrong in (-1, 65536):
        with pytest.raises(ConfigError, match="expected a number from 0 to 65535"):
            listen(wrong, None)


def test_what_is_no_folder_or_not_ours_is_refused(movies: Path, tmp_path: Path, capsys: Captured) -> None:
    assert cli.run(["app", str(tmp_path / "nothing"), "--workspace", str(tmp_path / "ws"), "--no-browser"]) == 2
    assert "expected a folder to open movies from" in capsys.readouterr().err
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "thesis.doc").touch()
    for workspace in (tmp_path / "thesis", tmp_path / "thesis" / "thesis.doc"):
        assert cli.run(["app", str(movies), "--workspace", str(workspace), "--no-browser"]) == 6
        assert "Choose another with --workspace" in capsys.readouterr().err or workspace.is_file()
    assert [file.name for file in (tmp_path / "thesis").iterdir()] == ["thesis.doc"]


@pytest.mark.parametrize("kept", ["", "{", "[]", '{"port": 80}', '{"port": 80, "token": "short"}',
                                  json.dumps({"port": 99999, "token": "t" * 43})])
def test_a_damaged_note_of_the_last_address_is_no_trouble(tmp_path: Path, kept: str) -> None:
    (tmp_path / ".microbundle_app.json").write_text(kept)
    assert read_door(tmp_path) is None


def test_a_missing_extra_is_told_with_the_line_that_installs_it(monkeypatch: pytest.MonkeyPatch, capsys: Captured,
                                                                tmp_path: Path) -> None:
    monkeypatch.setattr("microbundle.web.commands.find_spec", lambda name: None if name == "uvicorn" else name)
    assert cli.run(["app", "--workspace", str(tmp_path / "ws")]) == 2
    assert 'needs other packages (uvicorn): pip install "microbundle[web]"' in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_the_command_line_without_the_app_loads_nothing_of_it() -> None:
    code = "import sys; from microbundle.cli import run; run(['--help']); print(' '.join(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert {"starlette", "uvicorn", "jinja2", "microbundle.web"}.isdisjoint(loaded.splitlines()[-1].split())


def test_pages_that_are_gone_say_so_and_the_server_stays(serve: Serve, movies: Path, tmp_path: Path) -> None:
    server = serve(movies, tmp_path / "ws")
    with socket.create_connection(("127.0.0.1", server.kept["port"]), 5) as rude:
        rude.sendall(b"\x16\x03\x01" + os.urandom(200))
    with socket.create_connection(("127.0.0.1", server.kept["port"]), 5) as rude:
        rude.sendall(b"POST /api/open HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 5\r\nContent-Length: 6\r\n\r\n")
        assert rude.recv(100).startswith(b"HTTP/1.1 40")
    page = server.client.get(f"/run/{shlex.quote('nothing')}", headers={"accept": "text/html"})
    assert (page.status_code, "there is no such run" in page.text) == (404, True)
    assert until(lambda: server.client.get("/api/app").status_code == 200)
