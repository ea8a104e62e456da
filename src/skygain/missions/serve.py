"""The live page of a mission: a small web server for this machine, or with a token for others.

Reading is open on this machine's own address and needs the token elsewhere; writing always needs
it. Nothing is loaded from anywhere else.
"""

from __future__ import annotations

__all__ = ["application", "is_loopback", "kept_token"]

import asyncio
import contextlib
import hmac
import ipaddress
import json
import math
import secrets
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import (
    FileResponse,
    JSONResponse,
    PlainTextResponse,
    Response,
    StreamingResponse,
)
from starlette.routing import Route

from skygain.ground.errors import InputError
from skygain.ground.files import atomic_write
from skygain.missions.folder import Mission
from skygain.missions.ingest import take_in
from skygain.missions.posting import MOST_BYTES as POST_BYTES
from skygain.missions.posting import BusyError, Posts, posted_readings
from skygain.missions.watching import Watched

MOST_BYTES = 200_000_000
"""largest log that is taken over the page"""
_LOOK_S = 0.4
_TOKEN_CHARACTERS = 32
_BEAT_S = 15.0
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
Answer = Callable[[Request], Awaitable[Response]]


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach ``host``."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def kept_token(folder: Path) -> str:
    """The mission's token, made when it is first asked for; the page's address and senders keep
    working when the server is started again.

    Raises:
        InputError: the folder cannot be written.
    """
    path = folder / ".token"
    with contextlib.suppress(OSError, UnicodeDecodeError):
        token = path.read_text(encoding="ascii").strip()
        if len(token) >= _TOKEN_CHARACTERS:
            return token
    token = secrets.token_urlsafe(24)
    with atomic_write(path) as tmp:
        tmp.chmod(0o600)
        tmp.write_text(token + "\n", encoding="ascii")
    return token


def application(folder: Path, host: str, token: str) -> Starlette:
    """The server's application.

    Args:
        folder: of the mission.
        host: address it listens on.
        token: what a writer has to show, and on another address than this machine's own a reader
            too.

    Raises:
        InputError: there is no mission.
    """
    watched = Watched(folder)
    _ = watched.place
    watched.maps(watched.now()["count"])
    posts = Posts(folder / "journal.sqlite")
    open_to_read = is_loopback(host)

    def shown(request: Request) -> bool:
        given = request.headers.get("authorization", "").removeprefix("Bearer ")
        given = given or request.query_params.get("token", "")
        return hmac.compare_digest(given.encode(), token.encode())

    def reading(answer: Answer) -> Answer:
        async def checked(request: Request) -> Response:
            if not (open_to_read or shown(request)):
                return _refused()
            try:
                return _sealed(await answer(request))
            except InputError as error:
                return _sealed(JSONResponse({"error": str(error)}, status_code=409))

        return checked

    def writing(answer: Answer) -> Answer:
        async def checked(request: Request) -> Response:
            if not shown(request):
                return _refused()
            try:
                return _sealed(await answer(request))
            except InputError as error:
                return _sealed(JSONResponse({"error": str(error)}, status_code=400))

        return checked

    def page(name: str, kind: str) -> Answer:
        async def answer(request: Request) -> Response:
            text = (files("skygain.missions") / "page" / name).read_text(encoding="utf-8")
            return _sealed(Response(text, media_type=kind))

        return answer

    async def place(request: Request) -> Response:
        return JSONResponse(watched.place)

    async def story(request: Request) -> Response:
        return JSONResponse(await run_in_threadpool(watched.story))

    async def maps(request: Request) -> Response:
        count = int(request.path_params["count"])
        mean, std, error = await run_in_threadpool(watched.maps, count)
        body = mean.astype("<f4").tobytes() + std.astype("<f4").tobytes()
        headers = {"X-Expected-Error": f"{error:.3f}"}
        return Response(body, media_type="application/octet-stream", headers=headers)

    async def curve(request: Request) -> Response:
        return JSONResponse(await run_in_threadpool(watched.curve))

    async def heard(request: Request) -> Response:
        after = int(_number(request, "after"))
        return JSONResponse(await run_in_threadpool(watched.heard, max(0, after)))

    async def changes(request: Request) -> Response:
        return StreamingResponse(
            _changes(watched, request),
            media_type="text/event-stream",
            headers={"Content-Encoding": "identity"},
        )

    async def readings(request: Request) -> Response:
        name = Path(request.query_params.get("name", "log.csv")).name or "log.csv"
        shift = _number(request, "shift_hours")
        with tempfile.TemporaryDirectory() as place_for:
            path = Path(place_for) / name[-120:]
            size = 0
            with path.open("wb") as file:
                async for chunk in request.stream():
                    size += len(chunk)
                    if size > MOST_BYTES:
                        raise InputError(
                            f"{name} has more than {MOST_BYTES / 1e6:.0f} MB; give it to skygain "
                            "mission ingest"
                        )
                    file.write(chunk)
            told = await run_in_threadpool(_taken, folder, path, shift, watched)
        return JSONResponse({"told": told})

    async def posted(request: Request) -> Response:
        body = bytearray()
        async for chunk in request.stream():
            body += chunk
            if len(body) > POST_BYTES:
                raise InputError(
                    f"the post has more than {POST_BYTES / 1e6:.0f} MB; send fewer readings at once"
                )
        kind = request.headers.get("content-type", "application/json")
        readings = posted_readings(bytes(body), kind, watched.wanted())
        try:
            new = await asyncio.wrap_future(posts.add(readings))
        except BusyError:
            told = {"error": "too many readings wait to be written; post them again in a second"}
            return JSONResponse(told, status_code=503, headers={"Retry-After": "1"})
        return JSONResponse({"readings": len(readings), "new": new})

    @contextlib.asynccontextmanager
    async def writing_posts(_: Starlette) -> AsyncIterator[None]:
        with posts:
            yield

    async def download(request: Request) -> Response:
        number, name = int(request.path_params["number"]), request.path_params["name"]
        path = folder / "sorties" / f"{number:03d}" / name
        if Path(name).name != name or name.startswith(".") or not path.is_file():
            return PlainTextResponse("there is no such file", status_code=404)
        if name.endswith(".html"):
            return FileResponse(path, filename=name)
        return FileResponse(path, filename=name, media_type="application/octet-stream")

    names = ["127.0.0.1", "localhost", "[::1]", host] if open_to_read else ["*"]
    return Starlette(
        routes=[
            Route("/", page("page.html", "text/html")),
            Route("/page.css", page("page.css", "text/css")),
            Route("/page.js", page("page.js", "text/javascript")),
            Route("/api/place", reading(place)),
            Route("/api/story", reading(story)),
            Route("/api/maps/{count:int}", reading(maps)),
            Route("/api/curve", reading(curve)),
            Route("/api/changes", reading(changes)),
            Route("/api/readings", reading(heard), methods=["GET"]),
            Route("/api/readings", writing(readings), methods=["PUT"]),
            Route("/api/readings", writing(posted), methods=["POST"]),
            Route("/sorties/{number:int}/{name:str}", reading(download)),
        ],
        middleware=[
            Middleware(TrustedHostMiddleware, allowed_hosts=names),
            Middleware(GZipMiddleware, minimum_size=2000),
        ],
        lifespan=writing_posts,
    )


def _sealed(response: Response) -> Response:
    for key, value in _HEADERS.items():
        response.headers.setdefault(key, value)
    return response


def _refused() -> Response:
    told = "this needs the token that skygain mission serve printed"
    return _sealed(JSONResponse({"error": told}, status_code=401))


def _number(request: Request, name: str) -> float:
    text = request.query_params.get(name, "0")
    with contextlib.suppress(ValueError):
        value = float(text)
        if math.isfinite(value):
            return value
    raise InputError(f"`{name}` must be a number, got {text[:40]!r}")


def _taken(folder: Path, path: Path, shift_hours: float, watched: Watched) -> str:
    with Mission.opened(folder) as mission, mission.writing("skygain mission serve"):
        mission.__dict__["site"] = watched.site
        intake = take_in(mission, [path], None, shift_hours)
    return "; ".join(map(str, intake.logs))


async def _changes(watched: Watched, request: Request) -> AsyncIterator[str]:
    """What `Watched.now` tells, whenever it changes."""
    before: dict[str, Any] = {}
    quiet_s = 0.0
    while not await request.is_disconnected():
        now = await run_in_threadpool(watched.now)
        if now != before:
            yield f"data: {json.dumps(now)}\n\n"
            before, quiet_s = now, 0.0
        elif quiet_s >= _BEAT_S:
            yield ": still here\n\n"
            quiet_s = 0.0
        await asyncio.sleep(_LOOK_S)
        quiet_s += _LOOK_S
