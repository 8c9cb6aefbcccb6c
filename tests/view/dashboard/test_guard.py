"""Who may open the dashboard."""

from __future__ import annotations

import time
from typing import Any

import pytest
from starlette.types import Message, Receive, Scope, Send

from poise.endpoint import is_loopback
from poise.view.dashboard.dashboard_server import Guard

TOKEN = "a-token"


async def inner(_scope: Scope, _receive: Receive, send: Send) -> None:
    await send({"type": "http.response.start", "status": 200, "headers": []})


def answer_to(
    token: str = "",
    query: str = "",
    kind: str = "http",
    port: int = 7480,
    **headers: str,
) -> Message:
    """Return how the answer to a request begins."""
    sent: list[Message] = []

    async def receive() -> Message:
        raise AssertionError

    async def send(message: Message) -> None:
        sent.append(message)

    scope = {
        "type": kind,
        "path": "/",
        "scheme": "https",
        "server": ("robot", port),
        "query_string": query.encode(),
        "headers": [(k.encode(), v.encode()) for k, v in headers.items()],
    }
    with pytest.raises(StopIteration):  # it waits for nothing, so needs no event loop
        Guard(inner, {token: True} if token else {})(scope, receive, send).send(None)
    return sent[0]


def status(*request: Any, **more: Any) -> object:
    """Return the status of the answer to a request, or why a socket was closed."""
    answer = answer_to(*request, **more)
    return answer.get("status", answer.get("code"))


@pytest.mark.parametrize("host", ["localhost:7480", "127.0.0.1:7480", "[::1]:7480"])
def test_this_computer_is_let_in(host: str) -> None:
    assert status(host=host) == 200
    assert status(host=host, origin=f"http://{host}") == 200


def test_another_name_for_this_computer_is_refused() -> None:
    """Else a page of that name could read ours (DNS rebinding)."""
    assert status(host="evil.example") == 403
    assert status(kind="websocket", host="evil.example") == 1008
    assert status() == 403


def test_pages_of_other_sites_are_refused() -> None:
    origin = "http://evil.example"
    assert status(host="localhost:7480", origin=origin) == 403
    assert status(kind="websocket", host="localhost:7480", origin=origin) == 1008
    assert (
        status(TOKEN, host="r:1", origin=origin, cookie=f"poise_token7480={TOKEN}")
        == 403
    )


def test_no_page_of_another_site_may_show_ours_in_a_frame() -> None:
    """Else it could have a click that is meant for it stop the robot."""
    rule = (b"content-security-policy", b"frame-ancestors 'none'")
    assert rule in answer_to(host="localhost:7480")["headers"]
    cookie = f"poise_token7480={TOKEN}"
    assert rule in answer_to(TOKEN, host="robot:7480", cookie=cookie)["headers"]


def test_other_addresses_need_the_token_once_and_then_its_cookie() -> None:
    assert status(TOKEN, host="robot:7480") == 403
    assert status(TOKEN, host="robot:7480", query="token=wrong") == 403
    assert status(TOKEN, host="robot:7480", query=f"token={TOKEN}") == 303
    assert status(TOKEN, host="robot:7480", cookie=f"poise_token7480={TOKEN}") == 200
    assert status(TOKEN, host="robot:7480", cookie="poise_token7480=wrong") == 403
    assert status(TOKEN, kind="websocket", host="robot:7480") == 1008


def test_dashboards_of_one_computer_keep_each_other_s_cookies() -> None:
    """Browsers send a cookie to all ports of a computer, and have one of a name."""
    kept: dict[str, str] = {}
    for port in (7480, 7481):
        answer = answer_to(TOKEN, f"token={TOKEN}", port=port, host="robot")
        cookie, *rules = dict(answer["headers"])[b"set-cookie"].decode().split("; ")
        assert "Secure" in rules
        kept |= dict([cookie.split("=")])
    cookies = "; ".join(f"{name}={value}" for name, value in kept.items())
    for port in (7480, 7481):
        assert status(TOKEN, host="robot", port=port, cookie=cookies) == 200
    del kept["poise_token7481"]
    cookies = "; ".join(f"{name}={value}" for name, value in kept.items())
    assert status(TOKEN, host="robot", port=7481, cookie=cookies) == 403


def test_who_has_no_token_cannot_hold_up_the_dashboard() -> None:
    """Python 3.11 takes 7 s to unescape such a value."""
    began = time.monotonic()
    assert status(TOKEN, host="robot", cookie='x="' + '\\"' * 16000 + '"') == 403
    assert time.monotonic() - began < 1.0


@pytest.mark.parametrize(("token", "may"), [("acts", True), ("looks", False)])
def test_a_token_says_whether_one_may_act(token: str, *, may: bool) -> None:
    seen: list[object] = []

    async def look(scope: Scope, _receive: Receive, _send: Send) -> None:
        seen.append(scope["poise_may_act"])

    async def receive() -> Message:
        raise AssertionError

    async def send(_: Message) -> None:
        raise AssertionError

    cookie = (b"cookie", f"poise_token={token}".encode())
    scope = {"type": "http", "query_string": b"", "headers": [cookie]}
    guard = Guard(look, {"acts": True, "looks": False})
    with pytest.raises(StopIteration):
        guard(scope, receive, send).send(None)
    assert seen == [may]


def test_knows_the_addresses_of_this_computer_alone() -> None:
    assert is_loopback("127.0.0.1")
    assert is_loopback("::1")
    assert is_loopback("localhost")
    assert not is_loopback("0.0.0.0")
    assert not is_loopback("robot.local")
