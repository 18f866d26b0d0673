"""Answers for blind review: what is shown of a movie whose name is hidden."""

from __future__ import annotations

from typing import Any

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from ..store import glance
from .answers import Refused, answer, body_of, text_in
from .desk import Desk
from .frames import timing
from .masks import polygons
from .results import result_of
from .review import Case
from .routes_movies import limits, opened, picture
from .routes_runs import desk_of, run_of
from .run_view import shown_terms

HIDDEN = "A movie under review"


async def following(request: Request) -> Response:
    desk, run, asked = desk_of(request), run_of(request), await body_of(request)
    seed = str(asked.get("seed", ""))[:100]
    return answer(await desk.do("plan", desk.reviews.next, desk, run, text_in(asked, "reviewer", 100), seed))


async def judge(request: Request) -> Response:
    desk, asked = desk_of(request), await body_of(request)
    accept = asked.get("accept")
    if accept is not None and not isinstance(accept, bool):
        raise Refused(400, "BadRequest", "accept: expected true, false, or null for not sure")
    await desk.do("light", desk.reviews.judge, desk, request.path_params["token"], accept,
                  text_in(asked, "why", 2000, ""))
    return answer({})


async def case(request: Request) -> Response:
    desk, one = _case(request)
    return answer(await desk.do("results", _told, desk, one))


def _told(desk: Desk, one: Case) -> dict[str, Any]:
    home = desk.runs.home(one.run)
    task = desk.views.task(one.run, one.key)
    found = glance(result_of(home, one.key))
    row = desk.views.movie(desk.runs.get(one.run), home, task, desk.runs.progress(one.run))
    rows, cols = found.tissue.shape
    outer, holes = polygons(found.tissue)
    return {
        "info": {"frames": found.frame_count, "rows": rows, "cols": cols, **timing(found.time_s)},
        "outlines": {"tissue": outer, "holes": holes,
                     "pillars": [line for mask in found.pillars for line in polygons(mask)[0]]},
        "beats": found.beat_count,
        "numbers": [{"label": term.name, "value": row["metrics"][term.column], "se": row["se"].get(term.column),
                     "unit": term.unit} for term in shown_terms(row["metrics"])]}


async def frame(request: Request) -> Response:
    desk, one = _case(request)
    task = await desk.do("light", desk.views.task, one.run, one.key)
    return await picture(request, desk, await desk.do("open", opened, desk, one.run, task))


async def grey(request: Request) -> Response:
    desk, one = _case(request)
    task = await desk.do("light", desk.views.task, one.run, one.key)
    return await limits(desk, await desk.do("open", opened, desk, one.run, task))


async def traces(request: Request) -> Response:
    desk, one = _case(request)
    found = await desk.do("results", desk.results.traces, result_of(desk.runs.home(one.run), one.key))
    return answer(found | {"name": HIDDEN})


def _case(request: Request) -> tuple[Desk, Case]:
    desk = desk_of(request)
    return desk, desk.reviews.case(request.path_params["token"])


REVIEW_ROUTES = [
    Route("/runs/{run}/review/next", following, methods=["POST"]),
    Route("/review/{token}", case), Route("/review/{token}", judge, methods=["POST"]),
    Route("/review/{token}/frame", frame), Route("/review/{token}/grey", grey),
    Route("/review/{token}/traces", traces),
]
