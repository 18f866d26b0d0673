"""The app as ASGI: which address is answered by whom, the guard around all, and the runs looked after beside it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Mount, Route
from starlette.types import ASGIApp

from ..errors import MicrobundleError
from . import pages
from .answers import Refused, not_there, refusal
from .desk import Desk
from .guard import Guard
from .routes_movies import MOVIE_ROUTES
from .routes_review import REVIEW_ROUTES
from .routes_runs import RUN_ROUTES

MOST_UPLOAD = 20 * 10**9
"""Bytes of what is dropped at once."""

PAGES = [
    Route("/", pages.home), Route("/help", pages.help_page), Route("/favicon.ico", pages.serve_asset),
    Route("/assets/{name}", pages.serve_asset), Route("/run/{run}", pages.run_page),
    Route("/run/{run}/review", pages.review_page), Route("/run/{run}/side", pages.side_page),
    Route("/run/{run}/{key}", pages.movie_page),
]


def make_app(desk: Desk, *, token: str, port: int, most_upload: int = MOST_UPLOAD) -> ASGIApp:
    """Make the app of a desk, for one port and one token."""

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        watching = asyncio.create_task(desk.watch())
        yield
        desk.stopping = True
        watching.cancel()
        with suppress(asyncio.CancelledError):
            await watching

    routes = [*PAGES, Mount("/api", routes=[*RUN_ROUTES, *MOVIE_ROUTES, *REVIEW_ROUTES])]
    app = Starlette(routes=routes, lifespan=lifespan, exception_handlers={
        Refused: _refused, MicrobundleError: _refused, OSError: _refused, Exception: _refused,
        404: _nowhere, 405: _nowhere})
    app.state.desk = desk
    return Guard(app, token=token, port=port, most_upload=most_upload)


async def _refused(request: Request, error: Exception) -> Response:
    told = refusal(error)
    if not pages.wants_page(request):
        return told
    title = {404: "Not there", 500: "The program failed"}.get(told.status_code, "Not possible")
    return pages.error_page(told.status_code, title, str(error))


async def _nowhere(request: Request, _: Exception) -> Response:
    return await _refused(request, not_there(f"{request.url.path[:200]}: there is no such page"))
