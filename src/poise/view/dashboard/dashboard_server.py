"""Gives the page to browsers, and reads the robot while somebody looks."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from urllib.parse import urlsplit

from nicegui import app, background_tasks, run, ui
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from poise.clock import wall_time
from poise.endpoint import is_loopback
from poise.view.dashboard.dialogs import PageActions
from poise.view.dashboard.state import Page, PageState, Updates
from poise.view.robot_view import LiveReader, LiveReading
from poise.wire.credentials import CERTIFICATE, PRIVATE_KEY, Credentials

_MAY_ACT = "poise_may_act"
"""In the scope of a request: whether who made it may act on the robot."""


class Guard:
    """Refuses requests before anything else sees them (ASGI).

    A page of another site that runs in the same browser must not act on the robot:
    hence the checks of `Origin` and, where there are no tokens, of `Host`. Nor may it
    show ours in a frame, where a click that is meant for it would stop the robot.

    `tokens`: those that open the page -> whether with it one may act.
    """

    def __init__(self, app: ASGIApp, tokens: Mapping[str, bool] = {}) -> None:
        self._app = app
        self._tokens = tokens

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        asked = HTTPConnection(scope)
        refusal = _refusal_of_site(asked.headers, needs_name=not self._tokens)
        _, port = scope.get("server") or ("", "")
        name = f"poise_token{port}"  # browsers send those of other ports, too
        is_page = scope["type"] == "http"
        shown = self._known(asked.query_params.get("token", "")) if is_page else ""
        token = shown or self._known(_cookie(asked.headers, name))
        if self._tokens and not token:
            refusal = refusal or _CLOSED
        if refusal and not is_page:
            await send({"type": "websocket.close", "code": 1008})
        elif refusal:
            await PlainTextResponse(refusal, 403)(scope, receive, send)
        elif shown:
            page = RedirectResponse("/", 303)
            is_encrypted = scope.get("scheme") == "https"
            page.set_cookie(
                name, token, httponly=True, samesite="strict", secure=is_encrypted
            )
            await page(scope, receive, send)
        else:
            scope[_MAY_ACT] = self._tokens.get(token, True)
            await self._app(scope, receive, _unframed(send))

    def _known(self, shown: str) -> str:
        """Return the token that is shown; empty: it is none."""
        given = shown.encode()
        return next(
            (t for t in self._tokens if secrets.compare_digest(given, t.encode())), ""
        )


def _unframed(send: Send) -> Send:
    """Return what sends an answer that no other page may show as a part of its own."""
    rule = b"content-security-policy", b"frame-ancestors 'none'"

    async def send_unframed(message: Message) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message["headers"], rule]
        await send(message)

    return send_unframed


_CLOSED = "open the address with the token that `poise dashboard` printed"


def _refusal_of_site(headers: Mapping[str, str], *, needs_name: bool) -> str:
    """Return why a page that a browser has may not use this one; empty: it may."""
    host, origin = headers.get("host", ""), headers.get("origin", "")
    try:
        origin_host, name = urlsplit(origin).netloc, urlsplit(f"//{host}").hostname
    except ValueError as error:
        return f"host {host!r} or origin {origin!r}: {error}"
    if origin and origin_host != host:
        return f"a page of {origin} may not use this robot"
    if needs_name and not is_loopback(name or ""):
        return f"{host} is not a name of this computer"
    return ""


def _cookie(headers: Mapping[str, str], name: str) -> str:
    """Return a cookie; Starlette takes seconds for one with many escapes in quotes."""
    cookies = (c.strip().partition("=") for c in headers.get("cookie", "").split(";"))
    return next((value for known, _, value in cookies if known == name), "")


EVERY = 0.2
"""The page is this old at most, on a quick link [s]."""
_LOOK_EVERY = 0.02
_UNWATCHED_EVERY = 1.0
"""While no page is open, the robot is read so seldom, for the history [s]."""
_RECONNECT_LIMIT = 20.0
"""A page that was cut off may come back within this time [s]. NiceGUI also derives from
it for how long one update may be on its way before the connection counts as lost: 8 s.
"""
_HERE = Path(__file__).parent


class RobotMap(ui.element, component="robot_map.js"):  # type: ignore[call-arg,misc]
    """The robot, as `robot_map.js` draws it."""


class Dashboard:
    """One robot, read once for all pages that are open."""

    def __init__(self, robot: str | None) -> None:
        self._reader = LiveReader(robot)
        self._state = PageState()
        self._page: Page = {}
        self._seen = LiveReading()
        self._viewers: set[str] = set()
        self._is_watched = asyncio.Event()

    async def keep_reading(self) -> None:
        """Read the robot again and again, often only while any page is open."""
        while True:
            with contextlib.suppress(TimeoutError):  # so that the history has all
                await asyncio.wait_for(self._is_watched.wait(), _UNWATCHED_EVERY)
            began = time.monotonic()
            seen = await run.io_bound(self._reader.poll)
            if seen is None:  # the server ends
                return
            self._seen = seen
            self._page = self._state.of(seen, began)
            await asyncio.sleep(max(0.0, EVERY - (time.monotonic() - began)))
            if not self._viewers:
                self._is_watched.clear()

    def build(self) -> None:
        """Build one page."""
        ui.add_head_html(f"<style>{(_HERE / 'style.css').read_text()}</style>")
        client = ui.context.client
        shown_title = ""
        request = client.request
        may_act = request is None or request.scope.get(_MAY_ACT, True)
        actions = PageActions(self._reader.running, may_act=may_act)
        robot_map = RobotMap()
        robot_map.on("what_if", lambda e: actions.ask(*e.args))
        robot_map.on("task", lambda e: actions.do_task(*e.args))
        robot_map.on(
            "component", lambda e: actions.show_component(str(e.args), self._page)
        )
        robot_map.on("entry", lambda e: actions.show_entry(e.args, self._seen.entries))
        with ui.row().classes("tools"):
            actions.place_undo()
            actions.place_stop()
            _place_theme()
        client.on_disconnect(lambda: self._viewers.discard(client.id))
        client.on_delete(lambda: self._viewers.discard(client.id))
        updates = Updates()
        robot_map.on("taken", updates.note_taken)

        def begin() -> None:
            updates.begin_anew()
            self._viewers.add(client.id)
            self._is_watched.set()

        client.on_connect(begin)

        def push() -> None:
            nonlocal shown_title
            if client.id not in self._viewers:
                return
            if (title := self._title()) != shown_title:
                shown_title = title
                ui.page_title(title)
            differ = updates.next(self._page, time.monotonic())
            if differ is not None:
                robot_map.run_method("show", differ, wall_time(), updates.is_whole)

        ui.timer(EVERY, push)

    def _title(self) -> str:
        """Return the tab's title: the robot, marked if something is wrong."""
        robot = self._page.get("robot", {}).get("", {})
        is_wrong = robot.get("trouble") or robot.get("deviations")
        return f"{'▲ ' if is_wrong else ''}{robot.get('name', 'no robot yet')} - Poise"


def _place_theme() -> None:
    """Place the button that changes between the system's theme, dark and light."""
    dark = ui.dark_mode(None)
    names = {None: "auto", True: "dark", False: "light"}
    following = {None: True, True: False, False: None}

    def change() -> None:
        dark.value = following[dark.value]
        button.text = f"Theme: {names[dark.value]}"

    button = ui.button("Theme: auto", on_click=change)
    button.props('outline dense no-caps color=""')


async def _listens(host: str, port: int) -> bool:
    try:
        _, writer = await asyncio.open_connection(host, port)
    except OSError:
        return False
    writer.close()
    return True


def serve(
    robot: str | None,
    host: str,
    port: int,
    say: Callable[[str], object],
    keys: Credentials | None = None,
) -> None:
    """Serve the page until Ctrl-C, encrypted by `keys`, if any."""
    tokens: dict[str, bool] = {}
    if not is_loopback(host):
        tokens = {secrets.token_urlsafe(18): may_act for may_act in (True, False)}
    dashboard = Dashboard(robot)
    app.add_middleware(Guard, tokens=tokens)
    app.on_startup(
        lambda: background_tasks.create(dashboard.keep_reading(), name="reader")
    )
    for name in ("routes.js", "charts.js"):
        app.add_static_file(local_file=_HERE / name, url_path=f"/poise/{name}")
    at = f"[{host}]" if ":" in host else host
    address = f"{'https' if keys else 'http'}://{at}:{port}/"
    first, *others = [f"{address}?token={token}" for token in tokens] or [address]

    async def say_where() -> None:
        while not await _listens(host, port):  # noqa: ASYNC110, uvicorn tells nobody
            await asyncio.sleep(_LOOK_EVERY)
        say(f"the dashboard is at {first}; Ctrl-C ends it")
        for other in others:
            say(f"for viewers: {other}")

    app.on_startup(lambda: background_tasks.create(say_where(), name="where"))
    ui.page("/", title=f"Poise: {robot}" if robot else "Poise")(dashboard.build)
    ui.run(
        host=host,
        port=port,
        language="en-US",
        dark=None,
        show=False,
        reload=False,
        tailwind=False,
        binding_refresh_interval=None,
        reconnect_timeout=_RECONNECT_LIMIT,
        message_history_length=100,
        show_welcome_message=False,
        ssl_certfile=keys and str(keys.folder / CERTIFICATE),
        ssl_keyfile=keys and str(keys.folder / PRIVATE_KEY),
    )
