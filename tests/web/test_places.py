"""Only the opened folders are looked into, whatever an address, a link, a manifest or a dropped name says."""

from __future__ import annotations

import io
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
import tifffile
from starlette.testclient import TestClient

from microbundle.web.uploads import safe_parts

from .conftest import Opened, said

SCRIPT = "<script>alert(1)</script> & 'x' \"y\""


@pytest.fixture
def data(movies: Path, tmp_path: Path) -> Path:
    """A folder with movies, and beside it one that was not opened."""
    shutil.copytree(movies, tmp_path / "data" / "plate1")
    shutil.copytree(movies, tmp_path / "secret" / "plate2")
    (tmp_path / "data" / "notes.csv").write_text("a,b\n1,2\n")
    (tmp_path / "data" / "plan.csv").write_text("movie,fps\nplate1/P_A1.tif,30\n")
    return tmp_path / "data"


def entries(client: TestClient, at: str) -> dict[str, str]:
    return {one["name"]: one["kind"] for one in said(client.get("/api/browse", params={"at": at}))["entries"]}


def test_folders_movies_and_manifests_are_told_apart(open_app: Opened, data: Path) -> None:
    client = open_app(data)
    assert entries(client, "") == {"data": "folder"}
    assert entries(client, "data") == {"plate1": "folder", "plan.csv": "manifest"}
    assert entries(client, "data/plate1") == {"P_A1.tif": "movie", "P_B2": "movie", "P_B3.tif": "movie"}
    found = said(client.get("/api/browse?at=data/plate1/P_B2"))
    assert (found["kind"], found["openable"], found["entries"]) == ("movie", True, [])
    assert [one["at"] for one in found["crumbs"]] == ["data", "data/plate1", "data/plate1/P_B2"]


@pytest.mark.parametrize("at", [
    "data/..", "data/../secret", "data/plate1/../../secret", "data//etc", "data/./plate1", "/", "/etc", "..", "secret",
    "data/..\\secret", "data/\0", "data/plate1/", "nothing", "data/plate1/P_A1.tif/..", "data/%2e%2e", "C:\\"])
def test_no_address_leads_out(open_app: Opened, data: Path, at: str) -> None:
    client = open_app(data)
    for answer in (client.get("/api/browse", params={"at": at}), client.post("/api/open", json={"at": at})):
        assert answer.status_code == 404
        assert "plate2" not in answer.text


def test_links_out_are_neither_listed_nor_opened(open_app: Opened, data: Path) -> None:
    secret = data.parent / "secret" / "plate2"
    os.symlink(secret, data / "linked")
    os.symlink(secret / "P_A1.tif", data / "linked.tif")
    os.symlink(data / "plate1" / "P_A1.tif", data / "inside.tif")
    os.symlink("loop", data / "loop")
    client = open_app(data)
    assert set(entries(client, "data")) == {"plate1", "plan.csv", "inside.tif"}
    for at in ("data/linked", "data/linked.tif", "data/linked/P_A1.tif"):
        for answer in (client.get("/api/browse", params={"at": at}), client.post("/api/open", json={"at": at})):
            assert (answer.status_code, answer.json()["error"]["kind"]) == (403, "Outside")
    assert client.get("/api/browse?at=data/loop").status_code == 404
    assert client.post("/api/open", json={"at": "data"}).json()["error"]["kind"] == "Outside"
    assert said(client.post("/api/open", json={"at": "data/inside.tif"}))


def test_frames_that_are_links_out_are_not_shown(open_app: Opened, data: Path) -> None:
    frame = data / "plate1" / "P_B2" / "7.tif"
    frame.unlink()
    frame.symlink_to(data.parent / "secret" / "plate2" / "P_B2" / "7.tif")
    client = open_app(data)
    run = said(client.post("/api/open", json={"at": "data/plate1"}))["run"]
    for path in ("frame?t=0", "frame?t=7", "grey"):
        assert client.get(f"/api/runs/{run}/movies/P_B2/{path}").status_code == 403
    assert client.post(f"/api/runs/{run}/movies/P_B2/masks", json={}).status_code == 403
    assert client.get(f"/api/runs/{run}/movies/P_A1.tif/frame?t=0").status_code == 200


@pytest.mark.parametrize("path", ["../secret/plate2/P_A1.tif", "{}/secret/plate2/P_A1.tif", "../../../../etc/passwd"])
def test_a_manifest_cannot_name_what_was_not_opened(open_app: Opened, data: Path, path: str) -> None:
    (data / "evil.csv").write_text(f"movie\n{path.format(data.parent)}\n")
    answer = open_app(data).post("/api/open", json={"at": "data/evil.csv"})
    assert (answer.status_code, answer.json()["error"]["kind"]) == (403, "Outside")


def test_names_are_text_and_never_part_of_a_page(open_app: Opened, data: Path, small: Any) -> None:
    tifffile.imwrite(data / "plate1" / f"{SCRIPT.replace('/', '')}.tif", small[:5])
    client = open_app(data)
    listed = client.get("/api/browse?at=data/plate1")
    assert listed.headers["content-type"] == "application/json"
    run = said(client.post("/api/open", json={"at": "data/plate1"}))["run"]
    said(client.patch(f"/api/runs/{run}", json={"title": SCRIPT}))
    key = next(one["key"] for one in said(client.get(f"/api/runs/{run}"))["movies"] if "script" in one["movie"])
    for path in (f"/run/{run}", f"/run/{run}/{key}", f"/run/{run}/side?a={SCRIPT}&b={SCRIPT}", f"/run/{SCRIPT}",
                 f"/run/{run}/{SCRIPT}", f"/{SCRIPT}"):
        page = client.get(path, headers={"accept": "text/html"})
        assert "<script>alert" not in page.text
        assert page.headers["content-type"].startswith("text/html")


# --- what is dropped ------------------------------------------------------------------------------------------------


def upload(client: TestClient, *files: tuple[str, bytes]) -> Any:
    return client.post("/api/uploads", files=[("files", (name, io.BytesIO(content))) for name, content in files])


def left(tmp_path: Path) -> list[str]:
    home = tmp_path / "workspace" / "uploads"
    return sorted(file.relative_to(home).as_posix() for file in home.rglob("*") if file.is_file())


def test_a_dropped_folder_keeps_its_names_and_opens(open_app: Opened, movies: Path, tmp_path: Path) -> None:
    client = open_app(movies)
    frames = [(f"day 1/B2/{file.name}", file.read_bytes()) for file in sorted((movies / "P_B2").iterdir())]
    found = said(upload(client, *frames))
    assert (found["at"], found["files"]) == ("uploads/day 1", len(frames))
    assert (tmp_path / "workspace" / "uploads" / "day 1" / "B2" / "0.tif").read_bytes() == frames[0][1]
    run = said(client.post("/api/open", json={"at": found["at"]}))["run"]
    assert [one["movie"] for one in said(client.get(f"/api/runs/{run}"))["movies"]] == ["B2"]
    assert said(upload(client, *frames))["at"] == "uploads/day 1_2"
    assert said(upload(client, ("one.tif", (movies / "P_A1.tif").read_bytes())))["at"] == "uploads/one"


@pytest.mark.parametrize("name", ["../../evil.tif", "/etc/evil.tif", "C:\\evil.tif", "a/../../../evil.tif",
                                  "..\\..\\evil.tif", "....//evil.tif", "x\0/../evil.tif"])
def test_no_dropped_name_leads_out(open_app: Opened, movies: Path, tmp_path: Path, name: str) -> None:
    upload(open_app(movies), (name, b"II*\0"))
    assert [file for file in tmp_path.rglob("*evil*") if not file.is_relative_to(tmp_path / "workspace" / "uploads")
            ] == []
    assert not Path("/etc/evil.tif").exists()
    assert len(left(tmp_path)) == 1


@pytest.mark.parametrize(("name", "parts"), [
    ("a/b.tif", ["a", "b.tif"]), ("../..", ["file"]), ("", ["file"]), ("con.tif", ["_con.tif"]),
    (".ssh/x", ["ssh", "x"]),
    ("a<b>:|?*\n.tif", ["a_b______.tif"]), ("é ü.tif", ["é ü.tif"]), ("x" * 500 + ".tif", ["x" * 110 + ".tif"]),
    ("a" + "/b" * 50, ["b"] * 12), (" x. ", ["x"])])
def test_names_are_made_safe_for_any_system(name: str, parts: list[str]) -> None:
    assert safe_parts(name) == parts


def test_what_is_too_large_or_broken_leaves_nothing(open_app: Opened, movies: Path, tmp_path: Path) -> None:
    client = open_app(movies, most_upload=100_000)
    assert upload(client, ("big.tif", b"x" * 200_000)).status_code == 413
    kind = {"content-type": "multipart/form-data; boundary=xyz"}
    head = b'--xyz\r\nContent-Disposition: form-data; name="files"; filename="a.tif"\r\n\r\n'

    def endless() -> Any:
        yield head
        for _ in range(10):
            yield b"x" * 50_000

    assert client.post("/api/uploads", content=endless(), headers=kind).status_code == 413
    for body in (head + b"cut off", b"", b"nonsense", b"--xyz--\r\n", head):
        assert client.post("/api/uploads", content=body, headers=kind).status_code == 400
    assert client.post("/api/uploads", content=b"x", headers={"content-type": "text/plain"}).status_code == 400
    assert upload(client, ("a.tif", b"1"), ("a.tif", b"2")).status_code == 400
    assert left(tmp_path) == []
    assert list((tmp_path / "workspace" / "uploads").iterdir()) == []
