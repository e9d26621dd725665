"""The HTTP server of a lab: its token, its headers, its pages' files, and which door leads where.

Hides Starlette. Beside the host that it is for, it computes nothing: the index says what the folder holds, jobs are
processes, watched worlds are looked at between their ticks.

Invariant: everything but `/health` and the pages' own files wants the token, as a cookie or as `Authorization: Bearer`.
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Collection
from pathlib import Path
from typing import Final

from starlette.applications import Starlette
from starlette.datastructures import MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import Request, cookie_parser
from starlette.responses import FileResponse, RedirectResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket

from nmes.lab.api import routes
from nmes.lab.lab import Lab
from nmes.lab.poses import Watchers
from nmes.lab.recordings import show_recording
from nmes.server.http import OwnPages, refusal
from nmes.server.websocket import carry, health

__all__ = ["PAGES", "UNBUILT", "application", "new_token"]

PAGES: Final = Path(__file__).parent / "pages"
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' blob: data:; worker-src 'self' blob:; "
    "object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
_YEAR: Final = 365 * 24 * 3600  # s
UNBUILT: Final = (
    "The pages of the lab are not built: run `make lab`, or `python tools/lab_pages.py`, in the folder that NMES was "
    "installed from; unless the install is editable, install it again then. The API under /api works all the same."
)
"""What is told where there are no pages."""


def new_token() -> str:
    """Returns a token that nobody can guess."""
    return secrets.token_urlsafe(32)


def application(lab: Lab, token: str, password: str, names: Collection[str] = ()) -> ASGIApp:
    """Returns the application of a lab.

    Args:
        lab: The lab.
        token: What opens it.
        password: The host's, which whoever has the token need not say.
        names: What this machine is called.
    """
    watchers = Watchers(lab.host)

    async def index(request: Request) -> Response:
        given = request.query_params.get("token")
        if given is not None and hmac.compare_digest(given.encode(), token.encode()):
            response: Response = RedirectResponse("/", 303)
            response.set_cookie(
                _cookie_name(request.scope), token, max_age=_YEAR, path="/", httponly=True, samesite="strict"
            )
            return response
        page = PAGES / "index.html"
        return FileResponse(page) if page.is_file() else Response(UNBUILT, 200, media_type="text/plain")

    async def connect(websocket: WebSocket) -> None:
        await carry(lab.host, websocket, password)

    async def recording(websocket: WebSocket) -> None:
        await show_recording(lab, websocket)

    files = [Mount("/", StaticFiles(directory=PAGES))] if PAGES.is_dir() else []
    app = Starlette(
        routes=[
            Route("/", index),
            Route("/health", health),
            *routes(lab),
            WebSocketRoute("/ws", connect),
            WebSocketRoute("/ws/poses", watchers.serve),
            WebSocketRoute("/ws/recording", recording),
            *files,
        ],
        exception_handlers={HTTPException: _told, Exception: _told},
    )
    return OwnPages(_Headers(_Locked(app, token)), names)


async def _told(_: Request, error: Exception) -> Response:
    """Returns the answer to what there is no route for, or what failed, which is logged."""
    if not isinstance(error, HTTPException):
        return refusal(500, "internal", "the lab failed; see its log")
    code = {404: "not_found", 405: "method_not_allowed"}.get(error.status_code, "refused")
    return refusal(error.status_code, code, error.detail)


class _Locked:
    """Lets those in who have the token."""

    def __init__(self, app: ASGIApp, token: str) -> None:
        self._app, self._token = app, token.encode()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        locked = scope["path"].startswith(("/api", "/ws"))
        if locked and not self._opens(scope):
            reason = "open the address that `nmes lab` printed, which has the token in it"
            await refusal(401, "token_needed", reason)(scope, receive, send)
        else:
            await self._app(scope, receive, send)

    def _opens(self, scope: Scope) -> bool:
        given = []
        for name, value in scope["headers"]:
            if name == b"authorization" and value[:7].lower() == b"bearer ":
                given.append(value[7:].strip())
            elif name == b"cookie":
                cookies = cookie_parser(value.decode("latin-1"))  # of which those of other programs may be any text
                given.append(cookies.get(_cookie_name(scope), "").encode())
        return any(hmac.compare_digest(each, self._token) for each in given)


def _cookie_name(scope: Scope) -> str:
    """Returns the name of the cookie, with the port in it: of a name browsers keep one for all ports of a machine."""
    return f"nmes_lab_{scope['server'][1]}"


class _Headers:
    """Adds to each answer what browsers are to keep to."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def sending(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers[name] = value
                if scope["path"].startswith("/api"):
                    headers.setdefault("Cache-Control", "no-store")
            await send(message)

        await self._app(scope, receive, sending)
