"""Sessions of zenoh."""

from __future__ import annotations

import contextlib
import select
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path
from typing import IO
from unittest.mock import Mock

import pytest
import zenoh

from poise.endpoint import Endpoint
from poise.errors import RunError
from poise.session.keys import init_keys
from poise.wire.control_session import locator, open_session
from tests.runtime.conftest import free_port
from tests.waiting import wait_until


@pytest.mark.slow
@pytest.mark.parametrize(
    ("address", "why"),
    [("203.0.113.9:7447", "Cannot assign"), ("127.0.0.1:{busy}", "in use")],
)
def test_an_address_that_cannot_be_had_is_an_error(address: str, why: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as busy:
        endpoint = "tcp/" + address.format(busy=busy.getsockname()[1])
        with pytest.raises(RunError, match=f"cannot listen on {endpoint}: .*{why}"):
            open_session(listen=[endpoint])


def test_a_session_without_threads_names_the_limit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class PanicException(BaseException):
        """As Rust's panics are in Python."""

    why = "OS can't spawn worker thread: Resource temporarily unavailable (os error 11)"
    panic = PanicException(why)
    monkeypatch.setattr(zenoh, "open", Mock(side_effect=panic))
    with pytest.raises(RunError, match="no thread can be started: raise the limit"):
        open_session()


def test_the_last_part_of_an_ipv6_address_is_no_port() -> None:
    assert locator(Endpoint.parse("fd00::2")) == "tcp/[fd00::2]:7447"


@pytest.mark.slow
def test_keys_open_sessions_at_ipv6_addresses(tmp_path: Path) -> None:
    """Robots with such addresses started without keys, and never with any."""
    owner = init_keys("hello", tmp_path / "owner")
    agent = owner.issue("left", "agent", tmp_path / "left")
    manager = owner.issue("ann", "manager", tmp_path / "ann")
    where = locator(Endpoint("::1", free_port()), agent)
    with (
        open_session(listen=[where], keys=agent),
        open_session(connect=[where], keys=manager) as session,
    ):
        wait_until(session.info.peers_zid)


@pytest.mark.slow
def test_closing_a_link_to_a_computer_that_is_cut_off_keeps_nobody_waiting() -> None:
    """Zenoh's own SO_LINGER keeps the threads that receive waiting for 10 s."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with open_session(listen=[endpoint]), open_session(connect=[endpoint]):
        wait_until(lambda: len(connections(endpoint)) == 2)
        wait_until(lambda: not any(map(lingers, connections(endpoint))))


FROZEN = """
import sys, threading
from poise.wire.control_session import open_session

session = open_session(connect=[sys.argv[1]])
kept = session.declare_subscriber("states", lambda _: print("got", flush=True))
threading.Event().wait()
"""


def has_heard(session: zenoh.Session, said: IO[bytes]) -> bool:
    """Return whether a subscriber says that it hears what is put."""
    session.put("states", b"")
    return bool(select.select([said], [], [], 0.05)[0])


@pytest.mark.slow
def test_a_large_message_to_a_peer_that_stands_still_silences_no_other() -> None:
    """The others ended their sessions after 2 s, and were back after 5 s."""
    endpoint, block = f"tcp/127.0.0.1:{free_port()}", zenoh.CongestionControl.BLOCK
    heard: list[float] = []
    with (
        open_session(listen=[endpoint]) as session,
        open_session(connect=[endpoint]) as other,
        subprocess.Popen(
            [sys.executable, "-c", FROZEN, endpoint], stdout=subprocess.PIPE
        ) as frozen,
        ThreadPoolExecutor() as pool,
    ):
        said = frozen.stdout
        assert said is not None
        kept = other.declare_subscriber(
            "news", lambda _: heard.append(time.monotonic())
        )
        try:
            wait_until(lambda: has_heard(session, said))
            frozen.send_signal(signal.SIGSTOP)
            sent = pool.submit(
                session.put, "states", bytes(50_000_000), congestion_control=block
            )
            began = time.monotonic()
            while time.monotonic() < began + 4.0 or not sent.done():
                session.put("news", b"")
                time.sleep(0.05)
        finally:
            frozen.kill()
        del kept
    since = [began, *(at for at in heard if at > began), time.monotonic()]
    assert max(later - at for at, later in pairwise(since)) < 1.5


def connections(endpoint: str) -> list[int]:
    """Return this process's descriptors of connections to or from an endpoint."""
    found, port = [], int(endpoint.rpartition(":")[2])
    for name in [int(each.name) for each in Path("/proc/self/fd").iterdir()]:
        with contextlib.suppress(OSError), of_descriptor(name) as each:
            if port in {each.getsockname()[1], each.getpeername()[1]}:
                found.append(name)
    return found


@contextlib.contextmanager
def of_descriptor(fd: int) -> Iterator[socket.socket]:
    found = socket.socket(fileno=fd)
    try:
        yield found
    finally:
        found.detach()


def lingers(fd: int) -> bool:
    with of_descriptor(fd) as each:
        option = each.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8)
    return bool(struct.unpack("ii", option)[0])
