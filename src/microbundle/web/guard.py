"""Who may talk to the app: a browser on this computer that was given the token, on a page of the app itself.

Each request is checked before anything else sees it: its Host must be this computer's own name (a page elsewhere whose
name is made to lead here, "DNS rebinding", has another), it must not come from another page (Origin, Sec-Fetch-Site),
and must bring the token: in the address at first, then in a cookie that scripts cannot read and other sites do not
send. A change needs a header that no form of another site can send. Bodies are counted as they come.
"""

from __future__ import annotations

import logging
from secrets import compare_digest
from urllib.parse import parse_qsl, urlencode

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import cookie_parser
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from .answers import Refused, refusal

NAMES = ("127.0.0.1", "localhost", "[::1]")
SAFE = ("GET", "HEAD")
CHANGE = "x-microbundle"
MOST_BYTES = 32 * 2**20
"""Of the body of a request, but for uploads."""
UPLOADS = "/api/uploads"
KEPT_S = 30 * 86400
"""How long a browser keeps the token, so that a page can be opened again after it was closed."""
POLICY = ("default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
          "frame-src 'self'; media-src 'self' blob:; font-src 'none'; base-uri 'none'; form-action 'none'; "
          "frame-ancestors 'none'")
HEADERS = {"content-security-policy": POLICY, "referrer-policy": "no-referrer", "x-content-type-options": "nosniff",
           "cross-origin-opener-policy": "same-origin", "cross-origin-resource-policy": "same-origin",
           "cache-control": "no-store",
           "permissions-policy": "camera=(), microphone=(), geolocation=(), payment=(), usb=()"}
"""What every answer has, where it does not say otherwise itself."""
STRANGER = ("This page belongs to the microbundle app that runs on this computer. Open the whole address that it "
            "printed when it was started: it holds a token by which the app knows you.\n")

log = logging.getLogger(__name__)


class Guard:
    """Middleware around the whole app."""

    def __init__(self, app: ASGIApp, *, token: str, port: int, most_upload: int) -> None:
        self.app, self.token, self.most_upload = app, token, most_upload
        self.hosts = {f"{name}:{port}" for name in NAMES} | (set(NAMES) if port == 80 else set())
        self.cookie = f"microbundle_{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        if scope["type"] != "http":
            await send({"type": "websocket.close", "code": 1008})
            return
        begun = complete = False

        async def sending(message: Message) -> None:
            nonlocal begun, complete
            if message["type"] == "http.response.start":
                begun = True
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            elif message["type"] == "http.response.body":
                complete = not message.get("more_body", False)
            await send(message)

        try:
            early = self._early(scope)
            if early is not None:
                await early(scope, receive, sending)
            else:
                await self.app(scope, self._counted(scope, receive), sending)
        except Exception as error:
            if not isinstance(error, Refused):
                log.exception("%s %s", scope["method"], scope["path"])
            if begun and not complete:  # nothing can be said any more; the connection breaks off
                raise
            if not begun:
                await _told(scope, error)(scope, receive, sending)

    def _early(self, scope: Scope) -> Response | None:
        """Check who asks; gives the answer to the first visit, and raises Refused for anyone else."""
        headers = Headers(scope=scope)
        host = headers.get("host", "").lower()
        if host not in self.hosts or len(headers.getlist("host")) > 1:
            raise Refused(403, "WrongHost", "expected an address of this computer, such as 127.0.0.1; found another "
                          "name that leads here")
        origin = headers.get("origin")
        if origin is not None and origin.lower() != f"http://{host}":
            raise Refused(403, "WrongOrigin", "a page from elsewhere asks; only the app's own pages may")
        if headers.get("sec-fetch-site", "none") not in ("same-origin", "none"):
            raise Refused(403, "WrongOrigin", "a page from elsewhere asks; only the app's own pages may")
        visit = self._visit(scope)
        if visit is not None:
            return visit
        if not self._knows(headers):
            raise Refused(401, "NoToken", STRANGER)
        if scope["method"] not in SAFE and headers.get(CHANGE) != "1":
            raise Refused(403, "NoHeader", "expected the header X-Microbundle: 1 with a change")
        return None

    def _visit(self, scope: Scope) -> Response | None:
        """The first visit, with the token in the address: it goes into a cookie, and out of the address."""
        query = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
        given = [value for name, value in query if name == "token"]
        if not given or scope["method"] != "GET" or scope["path"].startswith("/api/"):
            return None
        if not compare_digest(given[0].encode(), self.token.encode()):
            return None
        rest = urlencode([(name, value) for name, value in query if name != "token"])
        path = "/" + scope["path"].lstrip("/")  # "//elsewhere" would be another site
        out = RedirectResponse(f"{path}?{rest}" if rest else path, 303)
        out.set_cookie(self.cookie, self.token, httponly=True, samesite="strict", path="/", max_age=KEPT_S)
        return out

    def _knows(self, headers: Headers) -> bool:
        given = cookie_parser(headers.get("cookie", "")).get(self.cookie, "")
        return compare_digest(given.encode(), self.token.encode())

    def _counted(self, scope: Scope, receive: Receive) -> Receive:
        """Count the bytes of a body as they come. Raises Refused before reading where too many are announced."""
        most = self.most_upload if scope["path"] == UPLOADS else MOST_BYTES
        announced = Headers(scope=scope).get("content-length", "0")
        if not announced.isdecimal() or int(announced) > most:
            raise _too_large(most)
        count = 0

        async def counting() -> Message:
            nonlocal count
            message = await receive()
            count += len(message.get("body", b""))
            if count > most:
                raise _too_large(most)
            return message

        return counting


def _too_large(most: int) -> Refused:
    return Refused(413, "TooLarge", f"expected at most {most / 1e6:.0f} MB; found more. Put large movies into a folder "
                   "that the app was started with, instead of dropping them")


def _told(scope: Scope, error: Exception) -> Response:
    """Answer a request that was refused, or failed."""
    if isinstance(error, Refused) and not scope["path"].startswith("/api/"):
        return PlainTextResponse(str(error), error.status)
    return refusal(error)
