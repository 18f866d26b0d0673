"""Nobody but the app's own pages gets an answer: hosts, origins, token, header, sizes; what every answer carries."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from .conftest import ORIGIN, PORT, TOKEN, Opened

CHANGES = [("POST", "/api/open"), ("POST", "/api/example"), ("POST", "/api/uploads"), ("PATCH", "/api/runs/x"),
           ("DELETE", "/api/runs/x"), ("POST", "/api/runs/x/start"), ("POST", "/api/runs/x/cancel"),
           ("PUT", "/api/runs/x/movies/y/decisions"), ("POST", "/api/runs/x/movies/y/masks"),
           ("POST", "/api/runs/x/movies/y/clicks"), ("POST", "/api/runs/x/review/next"), ("POST", "/api/review/t")]


@pytest.fixture
def client(open_app: Opened, tmp_path: Path) -> TestClient:
    (tmp_path / "data").mkdir()
    return open_app(tmp_path / "data")


def test_the_app_itself_is_answered(client: TestClient) -> None:
    answer = client.get("/api/app", headers={"origin": ORIGIN, "sec-fetch-site": "same-origin"})
    assert (answer.status_code, answer.json()["roots"][0]["id"]) == (200, "data")


@pytest.mark.parametrize("host", ["evil.example", f"evil.example:{PORT}", "127.0.0.1:9999", "127.0.0.1",
                                  f"127.0.0.1.evil.example:{PORT}", f"localhost.:{PORT}", f"0.0.0.0:{PORT}", ""])
def test_a_name_that_is_made_to_lead_here_gets_nothing(client: TestClient, host: str) -> None:
    for path in ("/", "/api/app", f"/?token={TOKEN}", "/assets/icon.svg"):
        answer = client.get(path, headers={"host": host})
        assert answer.status_code == 403
        assert "set-cookie" not in answer.headers


@pytest.mark.parametrize("host", [f"localhost:{PORT}", f"[::1]:{PORT}", f"LOCALHOST:{PORT}"])
def test_the_other_names_of_this_computer_are_answered(client: TestClient, host: str) -> None:
    assert client.get("/api/app", headers={"host": host, "cookie": f"microbundle_{PORT}={TOKEN}"}).status_code == 200


@pytest.mark.parametrize("headers", [
    {"origin": "http://evil.example"}, {"origin": "null"}, {"origin": f"https://127.0.0.1:{PORT}"},
    {"origin": "http://127.0.0.1:9999"}, {"origin": f"http://localhost:{PORT}"}, {"sec-fetch-site": "cross-site"},
    {"sec-fetch-site": "same-site"}])
def test_pages_from_elsewhere_get_nothing(client: TestClient, headers: dict[str, str]) -> None:
    for method, path in [("GET", "/api/app"), ("GET", "/"), *CHANGES]:
        answer = client.request(method, path, headers=headers)
        assert (answer.status_code, "access-control-allow-origin" in answer.headers) == (403, False)


def test_another_page_may_not_even_ask_whether_it_may(client: TestClient) -> None:
    answer = client.options("/api/open", headers={"origin": "http://evil.example",
                                                  "access-control-request-headers": "x-microbundle"})
    assert answer.status_code == 403
    assert not [name for name in answer.headers if name.startswith("access-control")]


@pytest.mark.parametrize("given", [None, "", "x", TOKEN[:-1], TOKEN + "t", "é" * 20])
def test_without_the_token_there_is_nothing(client: TestClient, given: str | None) -> None:
    client.cookies.clear()
    cookie = {} if given is None else {"cookie": f"microbundle_{PORT}={given}".encode()}
    for path in ("/", "/help", "/api/app", "/api/events", "/assets/icon.svg", "/favicon.ico", "/run/x/y", "/nowhere"):
        answer = client.get(path, headers=cookie)
        assert answer.status_code == 401
        assert TOKEN not in answer.text
    assert client.get(f"/api/app?token={TOKEN}").status_code == 401


def test_the_token_goes_from_the_address_into_a_cookie_that_scripts_cannot_read(client: TestClient) -> None:
    client.cookies.clear()
    answer = client.get(f"/run/x?a=1&token={TOKEN}&b=%26")
    assert (answer.status_code, answer.headers["location"]) == (303, "/run/x?a=1&b=%26")
    name, *rest = answer.headers["set-cookie"].split("; ")
    assert name == f"microbundle_{PORT}={TOKEN}"
    assert {part.lower() for part in rest if "max-age" not in part.lower()} == {"httponly", "samesite=strict", "path=/"}
    assert answer.headers["referrer-policy"] == "no-referrer"
    assert client.get(f"/?token={TOKEN[::-1]}x").status_code != 303


def test_the_first_visit_leads_nowhere_else(client: TestClient) -> None:
    for path in ("//evil.example/", "///evil.example", "/%2f/evil.example"):
        answer = client.get(f"{ORIGIN}{path}?token={TOKEN}")
        assert answer.headers.get("location", "/").startswith("/")
        assert not answer.headers.get("location", "/").startswith("//")


@pytest.mark.parametrize(("method", "path"), CHANGES)
def test_a_change_needs_the_header_that_no_form_can_send(client: TestClient, method: str, path: str) -> None:
    client.headers.pop("x-microbundle")
    answer = client.request(method, path, headers={"content-type": "text/plain"}, content="{}")
    assert (answer.status_code, answer.json()["error"]["kind"]) == (403, "NoHeader")


@pytest.mark.parametrize("path", ["/", "/help", "/api/app", "/api/nothing", "/nowhere", "/assets/shared.js",
                                  "/assets/nothing.js", "/run/nothing"])
def test_every_answer_says_what_a_browser_may_do_with_it(client: TestClient, path: str) -> None:
    headers = client.get(path, headers={"accept": "text/html"}).headers
    policy = dict(part.strip().partition(" ")[::2] for part in headers["content-security-policy"].split(";"))
    assert policy["default-src"] == policy["base-uri"] == policy["frame-ancestors"] == "'none'"
    assert policy["script-src"] == policy["style-src"] == policy["connect-src"] == "'self'"
    assert "unsafe" not in headers["content-security-policy"]
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["cross-origin-opener-policy"] == headers["cross-origin-resource-policy"] == "same-origin"


def test_pages_load_nothing_from_elsewhere_and_hold_no_script(client: TestClient) -> None:
    for path in ("/", "/help"):
        text = client.get(path).text
        assert "http://" not in text.replace("http://www.w3.org", "")
        assert "https://" not in text
        assert " style=" not in text
        assert "onclick" not in text
        assert all(part.partition(">")[0].endswith('"') and not part.partition(">")[2].partition("<")[0].strip()
                   for part in text.split("<script")[1:])


def test_a_body_is_counted_before_and_while_it_comes(client: TestClient) -> None:
    told = client.post("/api/open", content=b"{}", headers={"content-length": str(10**9)})
    assert (told.status_code, told.json()["error"]["kind"]) == (413, "TooLarge")

    def endless() -> Iterator[bytes]:
        for _ in range(64):
            yield b" " * 2**20

    assert client.post("/api/open", content=endless()).status_code == 413


@pytest.mark.parametrize("body", [b"[]", b"{", b"\xff", b"1", b"[" * 100_000, b'{"at": 3}', b"{}"])
def test_a_body_that_is_no_request_is_refused(client: TestClient, body: bytes) -> None:
    assert client.post("/api/open", content=body).status_code == 400


def test_nothing_but_http_is_spoken(client: TestClient) -> None:
    with pytest.raises(WebSocketDisconnect), client.websocket_connect("/api/events"):
        pass


@pytest.mark.parametrize("name", ["../app.py", "..%2fapp.py", "%2e%2e/app.py", "shell.html", ".hidden", "a/b.js"])
def test_only_assets_are_served_as_assets(client: TestClient, name: str) -> None:
    assert client.get(f"/assets/{name}").status_code == 404


def test_a_fault_of_the_program_is_told_in_a_sentence(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: Any) -> None:
        raise RuntimeError("broken")

    monkeypatch.setattr(client.desk.places, "browse", broken)  # type: ignore[attr-defined]
    answer = client.get("/api/browse")
    assert (answer.status_code, answer.json()["error"]["kind"]) == (500, "RuntimeError")
    assert "Traceback" not in answer.text
