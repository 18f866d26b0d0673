"""What the server answers: JSON, and errors as `{"error": {"kind", "message"}}` with a fitting status."""

from __future__ import annotations

import errno
import json
from typing import Any

from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response

from ..console import plain
from ..errors import CannotMeasure, ConfigError, MicrobundleError, MovieUnreadable, OutputError

UNFIT, FULL = 422, 507


class Refused(Exception):
    """A request that cannot be granted: a status, what kind of refusal, and why, with what else the page may need."""

    def __init__(self, status: int, kind: str, message: str, **more: Any) -> None:
        super().__init__(message)
        self.status, self.kind, self.more = status, kind, more


def not_there(message: str) -> Refused:
    """Make the refusal of something that does not exist."""
    return Refused(404, "NotThere", message)


def answer(content: Any, status: int = 200, **headers: str) -> Response:
    """Answer with JSON; what is not a number becomes null."""
    text = json.dumps(plain(content), allow_nan=False, separators=(",", ":"))
    return Response(text, status, headers, "application/json")


def refusal(error: Exception) -> Response:
    """Answer with an error: a refusal, one of our own errors, or a fault of the program."""
    if isinstance(error, Refused):
        return answer({"error": {"kind": error.kind, "message": str(error)}, **error.more}, error.status)
    if isinstance(error, MicrobundleError):
        return answer({"error": {"kind": type(error).__name__, "message": str(error)}}, status_of(error))
    if isinstance(error, OSError):
        kind = "DiskFull" if error.errno == errno.ENOSPC else "OSError"
        where = f"{error.filename}: " if error.filename else ""
        return answer({"error": {"kind": kind, "message": f"{where}{error.strerror or error}"}}, FULL)
    return answer({"error": {"kind": type(error).__name__, "message":
                             f"the program failed: {error}; please report this"}}, 500)


def status_of(error: MicrobundleError) -> int:
    """Choose the status of one of our errors."""
    if isinstance(error, OutputError):
        return FULL
    return UNFIT if isinstance(error, ConfigError | MovieUnreadable | CannotMeasure) else 500


async def body_of(request: Request) -> dict[str, Any]:
    """Read the JSON object that a request brings; nothing brings an empty one. Raises Refused."""
    try:
        content = await request.body()
        found = json.loads(content) if content else {}
    except ClientDisconnect:
        raise Refused(400, "BadRequest", "the request ended before it was complete") from None
    except (ValueError, RecursionError):
        raise Refused(400, "BadRequest", "expected a JSON object; found something else") from None
    if not isinstance(found, dict):
        raise Refused(400, "BadRequest", f"expected a JSON object; found {type(found).__name__}")
    return found


def text_in(found: dict[str, Any], name: str, most: int = 1000, default: str | None = None) -> str:
    """Take a text out of a request's object. Raises Refused where it is missing, no text, or longer than `most`."""
    value = found.get(name, default)
    if not isinstance(value, str) or len(value) > most:
        raise Refused(400, "BadRequest", f"{name}: expected a text of at most {most} letters")
    return value


def number_in(request: Request, name: str, kind: type[int] | type[float], default: Any = None) -> Any:
    """Take a number out of an address; `default` where it is not there. Raises Refused."""
    text = request.query_params.get(name, "")
    if text == "":
        return default
    try:
        value = kind(text)
    except ValueError:
        value = float("nan")
    if not abs(value) < 1e15:
        raise Refused(400, "BadRequest", f"{name}: expected a number; found {text[:50]!r}")
    return value
