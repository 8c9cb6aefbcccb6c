"""Whatever comes to the dashboard's port: it is answered or refused, and no more."""

from __future__ import annotations

import contextlib
import os
import select
import socket
from collections.abc import Iterator, Sequence
from urllib.parse import urlsplit

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.view.dashboard.test_dashboard import dashboard
from tests.view.dashboard.test_guard import TOKEN, status
from tests.waiting import LIMIT

METHODS = [
    *("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE", "CONNECT"),
    *("FETCH", "get"),
]
PLACES = [
    *("/", "*", "/poise/routes.js", "/poise/../../etc/passwd", "/_nicegui/x/static/a"),
    *("/_nicegui_ws/socket.io/?EIO=4&transport=polling", "/_nicegui/x/components/y"),
    *("/_nicegui_ws/socket.io/?EIO=4&transport=polling&sid=x", "/openapi.json"),
    *("/_nicegui_ws/socket.io/?EIO=4&transport=websocket", "/_nicegui/client/x"),
    *("/?token=x&token=y", "/%00", "/%ff%fe", "//evil.example/", "http://evil/"),
]
LATIN = st.characters(max_codepoint=255, exclude_categories=["Cc"])
TOKEN_SIGNS = st.sampled_from("!#$%&'*+-.^_`|~09azAZ")
URL_SIGNS = st.sampled_from("azAZ09/.%?&=#;:@[]{}~\"'<>|\\-_+,")
HEADERS = [
    *("Origin", "Cookie", "Host", "Upgrade", "Connection", "Range", "Accept"),
    *("Accept-Encoding", "Content-Type", "If-Modified-Since", "If-None-Match"),
    *("Sec-WebSocket-Version", "Sec-WebSocket-Key", "Expect", "X-Forwarded-For"),
    *("Content-Length", "Transfer-Encoding", "Cookie", "Cookie", "Origin", "Origin"),
]
VALUES = [
    *(
        "",
        "http://[",
        "http://localhost",
        "[",
        "a,b=1",
        "poise_token7480=",
        "websocket",
        "upgrade",
        "13",
    ),
    *("bytes=-", "bytes=9-1", "chunked", "-1", "99999999999", "100-continue", "gzip"),
    *("multipart/form-data", "application/json", "text/html; charset=x", "W/"),
]
PATIENCE = 0.5
"""Who has not answered by then [s] waits for the rest of the request."""
headers = st.lists(
    st.tuples(
        st.sampled_from(HEADERS) | st.text(TOKEN_SIGNS, min_size=1, max_size=10),
        st.sampled_from(VALUES) | st.text(LATIN, max_size=60),
    ),
    max_size=5,
)


@given(st.sampled_from(["http", "websocket"]), headers, st.text(max_size=60))
@pytest.mark.parametrize("token", ["", TOKEN])
def test_any_header_is_let_in_or_refused(
    token: str, kind: str, given_: list[tuple[str, str]], query: str
) -> None:
    known = {name.lower(): value for name, value in given_ if name.isidentifier()}
    known.pop("kind", None)
    known = {"host": "localhost", **known}
    said = status(token, query, kind, **known)
    assert said in {200, 303, 403, 1008}
    assert said != 200 or not token or TOKEN in known["cookie"]


@pytest.fixture(scope="module")
def server() -> Iterator[tuple[str, int]]:
    """Start a dashboard of a robot that does not run; return where it listens."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("PYTEST_CURRENT_TEST", raising=False)
        with dashboard(f"nowhere-{os.getpid()}") as address:
            place = urlsplit(address)
            assert place.hostname
            assert place.port
            yield place.hostname, place.port
            assert answer((place.hostname, place.port), request("GET", "/")) == 200


def request(
    method: str, path: str, lines: Sequence[tuple[str, str]] = (), body: bytes = b""
) -> bytes:
    known = {"Host": "localhost", **dict(lines)}
    if body:
        known.setdefault("Content-Length", str(len(body)))
    head = "".join(f"{name}: {value}\r\n" for name, value in known.items())
    return f"{method} {path} HTTP/1.1\r\n{head}\r\n".encode("latin-1") + body


def answer(server: tuple[str, int], data: bytes) -> int:
    """Return the status of the answer; 0: it waits for more, or closes without one."""
    with (
        socket.create_connection(server, LIMIT) as sock,
        contextlib.suppress(ConnectionError),  # it may close before all is sent
    ):
        sock.sendall(data)
        ready, _, _ = select.select([sock], [], [], PATIENCE)
        if not ready:
            sock.shutdown(socket.SHUT_WR)
        line = sock.recv(1 << 16).partition(b"\r\n")[0].split()
        assert not line or line[0] == b"HTTP/1.1", line
        return int(line[1]) if line else 0
    return 0


@pytest.mark.slow
@given(
    st.sampled_from(METHODS),
    st.sampled_from(PLACES) | st.text(URL_SIGNS, max_size=30).map(lambda t: f"/{t}"),
    headers,
    st.binary(max_size=300),
)
def test_any_request_is_answered_or_refused(
    server: tuple[str, int],
    method: str,
    path: str,
    lines: list[tuple[str, str]],
    body: bytes,
) -> None:
    assert answer(server, request(method, path, lines, body)) < 500


@pytest.mark.slow
@given(st.binary(max_size=500))
def test_any_bytes_are_answered_or_refused(
    server: tuple[str, int], data: bytes
) -> None:
    assert answer(server, data) < 500


@pytest.mark.slow
@pytest.mark.parametrize(
    "data",
    [
        request("GET", "/" + "x" * 10_000_000),
        request("GET", "/", [("Cookie", "a=b; " * 1_000_000)]),
        request("GET", "/", [(f"X-{n}", "y") for n in range(100_000)]),
        request("POST", "/", body=bytes(20_000_000)),
        request("POST", PLACES[5], body=bytes(20_000_000)),
        request("GET", "/?token=" + "%ff" * 20_000),
        b"GET / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\nffffffffffffffff\r\n",
    ],
    ids=["path", "cookie", "headers", "body", "poll", "token", "chunk"],
)
def test_what_is_huge_is_answered_or_refused(
    server: tuple[str, int], data: bytes
) -> None:
    assert answer(server, data) < 500
