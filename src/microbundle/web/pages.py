"""The pages themselves: templates, and the styles and scripts that they load. Names are escaped wherever they stand."""

from __future__ import annotations

import hashlib
import mimetypes
import re
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from typing import TYPE_CHECKING

from starlette.requests import Request
from starlette.responses import HTMLResponse, Response

from ..report.page import asset
from .answers import not_there
from .desk import Desk

if TYPE_CHECKING:
    from jinja2 import Environment

REPORT_STYLES = ("base.css", "chart.css")
"""Styles that the pages share with reports."""
SHARED = ("base.js", "chart.js", "map.js")
"""Scripts of reports that the pages use as one module, `shared.js`."""
TYPES = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml", ".png": "image/png"}
NAME = re.compile(r"[a-z0-9][a-z0-9_-]*(?:\.[a-z0-9]+)+")


@cache
def templates() -> Environment:
    """The templates; what is put into them is escaped."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(loader=PackageLoader(__package__), autoescape=True, undefined=StrictUndefined)


def page(name: str, **values: str | int) -> HTMLResponse:
    """Make a page of a template."""
    return HTMLResponse(templates().get_template(name).render(version=version("microbundle"), **values))


def error_page(status: int, title: str, message: str) -> Response:
    """Make the page that says why there is none."""
    out = page("error.html", status=status, title=title, message=message)
    out.status_code = status
    return out


@cache
def asset_text(name: str) -> bytes:
    """Read a style, script or picture of the pages. Raises Refused."""
    if name == "shared.js":
        text = "\n".join(asset(part) for part in SHARED)
        names = re.findall(r"^(?:async )?(?:function|class|const|let) (\w+)", text, re.MULTILINE)
        return f"{text}\nexport {{ {', '.join(names)} }};\n".encode()
    if name in REPORT_STYLES:
        return asset(name).encode()
    found = files(__package__) / "assets" / name
    if not NAME.fullmatch(name) or not found.is_file():
        raise not_there(f"{name[:100]}: there is no such file")
    return found.read_bytes()


async def serve_asset(request: Request) -> Response:
    """Answer with a style, script or picture."""
    name = request.path_params.get("name", "icon.svg")
    content = asset_text(name)
    tag = f'"{hashlib.sha256(content).hexdigest()[:20]}"'
    headers = {"etag": tag, "cache-control": "no-cache"}
    if request.headers.get("if-none-match") == tag:
        return Response(status_code=304, headers=headers)
    suffix = name[name.rfind("."):]
    return Response(content, headers=headers, media_type=TYPES.get(suffix) or mimetypes.guess_type(name)[0])


async def home(_: Request) -> Response:
    """The first page: what can be opened, and the runs."""
    return page("home.html")


async def help_page(_: Request) -> Response:
    """What everything means."""
    return page("help.html")


async def run_page(request: Request) -> Response:
    """One run."""
    return page("run.html", run=_run(request))


async def movie_page(request: Request) -> Response:
    """One movie of a run."""
    desk: Desk = request.app.state.desk
    run, key = _run(request), request.path_params["key"]
    await desk.do("plan", desk.views.task, run, key)
    return page("movie.html", run=run, key=key)


async def review_page(request: Request) -> Response:
    """Blind review of a run."""
    return page("review.html", run=_run(request))


async def side_page(request: Request) -> Response:
    """Two movies of a run side by side."""
    return page("side.html", run=_run(request), a=request.query_params.get("a", ""),
                b=request.query_params.get("b", ""))


def _run(request: Request) -> str:
    """The run of an address, which must be there."""
    desk: Desk = request.app.state.desk
    return desk.runs.get(request.path_params["run"]).id


def wants_page(request: Request) -> bool:
    """Tell whether a person is to read the answer."""
    return not request.url.path.startswith(("/api/", "/assets/")) and "text/html" in request.headers.get("accept", "")

