"""Who may open the dashboard: this computer's browsers, or who has the token."""

from __future__ import annotations

import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import SimpleCookie
from ipaddress import ip_address
from typing import Any
from urllib.parse import parse_qs, urlsplit

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

_COOKIE = "poise_token"


def is_loopback(host: str) -> bool:
    """Return whether only this computer reaches an address."""
    try:
        return ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


class Guard:
    """Refuses requests before anything else sees them (ASGI).

    A page of another site that runs in the same browser must not act on the robot:
    hence the checks of `Origin` and, where there is no token, of `Host`.

    Parameters
    ----------
    token
        What everyone must show, once in the address and then as a cookie; empty: only
        requests to a loopback name are let in.
    """

    def __init__(self, app: App, token: str = "") -> None:
        self._app = app
        self._token = token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        headers = {k.decode(): v.decode("latin-1") for k, v in scope["headers"]}
        refusal = self._refusal(scope, headers)
        if refusal and scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})
        elif refusal:
            await _answer(send, 403, [], refusal)
        elif self._is_shown_in_address(scope):
            cookie = f"{_COOKIE}={self._token}; HttpOnly; SameSite=Strict; Path=/"
            there = [(b"location", b"/"), (b"set-cookie", cookie.encode())]
            await _answer(send, 303, there, "")
        else:
            await self._app(scope, receive, send)

    def _refusal(self, scope: Scope, headers: dict[str, str]) -> str:
        host, origin = headers.get("host", ""), headers.get("origin", "")
        if origin and urlsplit(origin).netloc != host:
            return f"a page of {origin} may not use this robot"
        if not self._token:
            name = urlsplit(f"//{host}").hostname or ""
            return "" if is_loopback(name) else f"{host} is no name of this computer"
        cookie = SimpleCookie(headers.get("cookie", "")).get(_COOKIE)
        shown = cookie.value if cookie else ""
        if self._is_shown_in_address(scope) or _is_same(shown, self._token):
            return ""
        return "open the address with the token that `poise dashboard` printed"

    def _is_shown_in_address(self, scope: Scope) -> bool:
        if not self._token or scope["type"] != "http":
            return False
        shown = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])
        return _is_same(shown[0], self._token)


def _is_same(shown: str, token: str) -> bool:
    return secrets.compare_digest(shown.encode(), token.encode())


async def _answer(
    send: Send, status: int, headers: list[tuple[bytes, bytes]], text: str
) -> None:
    kind = (b"content-type", b"text/plain; charset=utf-8")
    start = {"type": "http.response.start", "status": status}
    await send({**start, "headers": [kind, *headers]})
    await send({"type": "http.response.body", "body": text.encode()})
