"""Answers about single movies of a run: frames, masks, results, decisions, clicks."""

from __future__ import annotations

import hashlib
from typing import Any

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from ..batch.plan import Task
from ..data import Bools
from ..errors import ChoiceMissing, MicrobundleError
from ..read import describe
from . import clicks, decided, masks
from .answers import Refused, answer, body_of, not_there, number_in
from .desk import Desk
from .frames import Shown, timing
from .results import files_of, findings_of, report_page, result_of, told
from .routes_runs import desk_of, run_of

ROOM = "/runs/{run}/movies/{key}"


async def task_of(request: Request) -> tuple[Desk, str, Task]:
    """The movie of an address, which must be there. Raises Refused."""
    desk, run = desk_of(request), run_of(request)
    return desk, run, await desk.do("light", desk.views.task, run, request.path_params["key"])


def opened(desk: Desk, run: str, task: Task) -> Shown:
    """Open a movie as the run, and a person's decisions on it, ask; its files must lie within the folders of the app.

    Raises Refused and MicrobundleError.
    """
    desk.places.check_frames(task.path)
    return desk.movies.open(task.path, decided.config_of(result_of(desk.runs.home(run), task.key), task.config))


async def movie(request: Request) -> Response:
    desk, run, task = await task_of(request)
    info = await desk.do("open", _info, desk, run, task)
    return answer(info | await desk.do("light", _about, desk, run, task))


def _info(desk: Desk, run: str, task: Task) -> dict[str, Any]:
    """What the file says, or why it cannot be opened."""
    try:
        shown = opened(desk, run, task)
    except ChoiceMissing as choice:
        inside = describe(task.path)
        return {"info": None, "missing": [], "problem": None,
                "to_choose": {"text": str(choice).removeprefix(f"{task.path}: "), "series": inside["series"]}}
    except MicrobundleError as error:
        return {"info": None, "to_choose": None, "missing": [],
                "problem": {"kind": type(error).__name__, "message": str(error)}}
    one = shown.movie
    missing = [name for name, value in (("fps", one.time_s), ("um_per_px", one.um_per_px)) if value is None]
    return {"to_choose": None, "problem": None, "missing": missing, "info": {
        "frames": one.count, "rows": one.shape[0], "cols": one.shape[1], **timing(one.time_s),
        "time_source": one.time_source, "um_per_px": one.um_per_px, "um_per_px_source": one.um_per_px_source,
        "duration_s": None if one.time_s is None else float(one.time_s[-1]), "masks": sorted(one.supplied_masks),
        "number_type": str(one.frames[0].dtype), "format": "folder" if task.path.is_dir() else
        task.path.suffix.lstrip(".").upper(), "findings": [told(finding) for finding in one.findings]}}


def _about(desk: Desk, run: str, task: Task) -> dict[str, Any]:
    """The movie in its run: what was decided and found, and its neighbours."""
    home, record = desk.runs.home(run), desk.runs.get(run)
    result = result_of(home, task.key)
    listed, version = decided.read(result)
    row = desk.views.movie(record, home, task, desk.runs.progress(run))
    row["decided"] = row.pop("decisions")
    try:
        keys = [one.key for one in desk.runs.plan(run).tasks]
    except MicrobundleError:
        keys = [task.key]
    at = keys.index(task.key)
    return row | {
        "title": record.title, "run_state": record.state, "decisions": listed, "version": version,
        "previous": keys[at - 1] if at else None, "next": keys[at + 1] if at + 1 < len(keys) else None,
        "result": {"state": row["state"], "verdict": row["verdict"], "findings": findings_of(result),
                   "files": files_of(home, result)}}


async def frame(request: Request) -> Response:
    desk, run, task = await task_of(request)
    return await picture(request, desk, await desk.do("open", opened, desk, run, task))


async def picture(request: Request, desk: Desk, shown: Shown) -> Response:
    """Answer with the picture of a frame."""
    t, width = number_in(request, "t", int, 0), number_in(request, "width", int)
    low, high = number_in(request, "low", float), number_in(request, "high", float)
    tag = f'"{hashlib.sha256(repr((shown.key, t, low, high, width)).encode()).hexdigest()[:20]}"'
    headers = {"etag": tag, "cache-control": "private, max-age=60"}
    if request.headers.get("if-none-match") == tag:
        return Response(status_code=304, headers=headers)
    content = await desk.do("frames", desk.movies.picture, shown, t, low, high, width)
    return Response(content, media_type="image/jpeg", headers=headers)


async def grey(request: Request) -> Response:
    desk, run, task = await task_of(request)
    return await limits(desk, await desk.do("open", opened, desk, run, task))


async def limits(desk: Desk, shown: Shown) -> Response:
    """Answer with the grey limits and the histogram of a movie."""
    one = await desk.do("frames", desk.movies.grey, shown)
    return answer({"low": one.low, "high": one.high, "min": one.least, "max": one.most, "histogram": one.histogram})


async def measure_masks(request: Request) -> Response:
    desk, run, task = await task_of(request)
    asked = await body_of(request)

    def work() -> dict[str, Any]:
        shown = opened(desk, run, task)
        return masks.measure(desk.found, shown, masks.wanted(shown, task.config, asked))

    return answer(await desk.do("masks", work))


async def decide(request: Request) -> Response:
    desk, run, task = await task_of(request)
    asked = await body_of(request)
    result, pictures = result_of(desk.runs.home(run), task.key), asked.get("masks") or {}
    version = asked.get("version")
    if not isinstance(pictures, dict) or not all(masks.NAME.fullmatch(name) for name in pictures):
        raise Refused(400, "BadRequest", "masks: expected tissue, pillar_1, pillar_2, ...")
    if version is not None and not isinstance(version, str):
        raise Refused(400, "BadRequest", "version: expected a text")

    def work() -> dict[str, Any]:
        drawn: dict[str, Bools] = {}
        if pictures:
            shown = opened(desk, run, task)
            drawn = {name: decided.whole_mask(masks.picture(png, shown.movie.shape), shown.whole, shown.crop_px)
                     for name, png in pictures.items()}
        listed, now = decided.write(result, asked.get("decisions"), drawn, version)
        desk.runs.touch()
        return {"decisions": listed, "version": now}

    return answer(await desk.do("light", work))


async def kept_mask(request: Request) -> Response:
    """A mask that a person decided on, on the frames as they are shown."""
    desk, run, task = await task_of(request)
    name = request.path_params["name"]

    def work() -> bytes:
        shown = opened(desk, run, task)
        drawn = decided.drawn_masks(result_of(desk.runs.home(run), task.key), shown.whole, shown.crop_px)
        if name not in drawn:
            raise not_there(f"{name[:50]}: nobody has decided on such a mask")
        return masks.png(drawn[name])

    return Response(await desk.do("open", work), media_type="image/png")


async def report(request: Request) -> Response:
    desk, run, task = await task_of(request)
    return await desk.do("files", report_page, result_of(desk.runs.home(run), task.key))


async def traces(request: Request) -> Response:
    desk, run, task = await task_of(request)
    return answer(await desk.do("results", desk.results.traces, result_of(desk.runs.home(run), task.key)))


async def verify(request: Request) -> Response:
    desk, run, task = await task_of(request)
    points = (await body_of(request)).get("points")

    def work() -> dict[str, Any]:
        return clicks.agreement(desk.results.load(result_of(desk.runs.home(run), task.key)), points)

    return answer(await desk.do("results", work))


MOVIE_ROUTES = [
    Route(ROOM, movie), Route(f"{ROOM}/frame", frame), Route(f"{ROOM}/grey", grey),
    Route(f"{ROOM}/masks", measure_masks, methods=["POST"]),
    Route(f"{ROOM}/decisions", decide, methods=["PUT"]), Route(f"{ROOM}/masks/{{name}}", kept_mask),
    Route(f"{ROOM}/report", report), Route(f"{ROOM}/traces", traces),
    Route(f"{ROOM}/clicks", verify, methods=["POST"]),
]
