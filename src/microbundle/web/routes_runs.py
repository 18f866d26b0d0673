"""Answers about the app, its folders and its runs."""

from __future__ import annotations

from importlib.metadata import version

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from . import archive, settings, streams, uploads
from .answers import Refused, answer, body_of, text_in
from .desk import Desk
from .results import outputs_of, plates_told, run_file

WELLS = (6, 12, 24, 48, 96)
EXAMPLE_WELLS = 24


def desk_of(request: Request) -> Desk:
    """The desk of the app that was asked."""
    desk: Desk = request.app.state.desk
    return desk


def run_of(request: Request) -> str:
    """The run of an address, which must be there. Raises Refused."""
    return desk_of(request).runs.get(request.path_params["run"]).id


async def about(request: Request) -> Response:
    desk = desk_of(request)
    return answer({"version": version("microbundle"), "workspace": str(desk.workspace), "example": True,
                   "pictures": True, "roots": [{"id": root.id, "name": root.name} for root in desk.places.roots]})


async def browse(request: Request) -> Response:
    desk = desk_of(request)
    return answer(await desk.do("light", desk.places.browse, request.query_params.get("at", "")))


async def upload(request: Request) -> Response:
    return answer(await uploads.receive(desk_of(request), request))


async def example(request: Request) -> Response:
    desk, wells = desk_of(request), (await body_of(request)).get("wells", EXAMPLE_WELLS)
    if wells not in WELLS:
        raise Refused(400, "BadRequest", f"wells: expected one of {', '.join(map(str, WELLS))}")
    record = await desk.do("plan", desk.runs.open_example, wells)
    return answer({"run": record.id})


async def open_place(request: Request) -> Response:
    desk, found = desk_of(request), await body_of(request)
    at = text_in(found, "at", 5000)
    record = await desk.do("plan", desk.runs.open, at, new=found.get("new") is True)
    return answer({"run": record.id})


async def runs(request: Request) -> Response:
    desk = desk_of(request)
    return answer({"runs": await desk.do("light", desk.views.listed)})


async def runs_events(request: Request) -> Response:
    return streams.list_events(desk_of(request))


async def run(request: Request) -> Response:
    return await _told(request)


async def run_events(request: Request) -> Response:
    return streams.run_events(desk_of(request), run_of(request))


async def change(request: Request) -> Response:
    desk, id = desk_of(request), run_of(request)
    await desk.do("plan", desk.runs.change, id, await body_of(request))
    return await _told(request)


async def start(request: Request) -> Response:
    desk, id = desk_of(request), run_of(request)
    await desk.do("plan", desk.runs.start, id)
    return await _told(request)


async def cancel(request: Request) -> Response:
    desk, id = desk_of(request), run_of(request)
    await desk.do("light", desk.runs.cancel, id)
    return await _told(request)


async def remove(request: Request) -> Response:
    desk, id = desk_of(request), run_of(request)
    await desk.do("light", desk.runs.remove, id)
    return answer({})


async def _told(request: Request) -> Response:
    desk, id = desk_of(request), run_of(request)
    return answer(await streams.run_told(desk, id))


async def plate(request: Request) -> Response:
    desk, id = desk_of(request), run_of(request)
    plan = await desk.do("plan", desk.runs.plan, id)
    return answer({"plates": plates_told(plan.tasks)})


async def outputs(request: Request) -> Response:
    desk, id = desk_of(request), run_of(request)
    return answer({"files": await desk.do("files", outputs_of, desk.runs.home(id))})


async def file(request: Request) -> Response:
    desk, id = desk_of(request), run_of(request)
    return await desk.do("files", run_file, desk.runs.home(id), request.path_params["path"],
                         inline=request.query_params.get("inline") == "1")


async def zipped(request: Request) -> Response:
    return archive.zip_of(desk_of(request), run_of(request), request.query_params.get("movies", "all"))


async def all_settings(_: Request) -> Response:
    return answer(settings.sections())


RUN_ROUTES = [
    Route("/app", about), Route("/browse", browse), Route("/uploads", upload, methods=["POST"]),
    Route("/example", example, methods=["POST"]), Route("/open", open_place, methods=["POST"]),
    Route("/settings", all_settings), Route("/events", runs_events), Route("/runs", runs),
    Route("/runs/{run}", run), Route("/runs/{run}", change, methods=["PATCH"]),
    Route("/runs/{run}", remove, methods=["DELETE"]), Route("/runs/{run}/start", start, methods=["POST"]),
    Route("/runs/{run}/cancel", cancel, methods=["POST"]), Route("/runs/{run}/events", run_events),
    Route("/runs/{run}/plate", plate), Route("/runs/{run}/outputs", outputs), Route("/runs/{run}/zip", zipped),
    Route("/runs/{run}/files/{path:path}", file),
]
