"""Hosts are looked up by name, and nobody waits for that."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator, Sequence

import pytest

from poise.clock import SystemClock
from poise.endpoint import Endpoint
from poise.wire.heartbeats import UdpDatagrams
from poise.wire.host_names import HostNames
from poise.wire.records.heartbeat_records import Heartbeat
from tests.runtime.conftest import free_port
from tests.waiting import wait_until

pytestmark = pytest.mark.slow

BEAT = Heartbeat(robot="r", sender="left", key="k", number=1, sent=0.0)


class NameServer:
    """Knows some names, and answers only while it `is_there`."""

    def __init__(self, **known: Sequence[str]) -> None:
        self.known = known
        self.is_there = threading.Event()
        self.is_there.set()
        self.num_asked = 0

    def getaddrinfo(
        self, host: str, _port: None, family: int, *_: object, **__: int
    ) -> list[tuple[object, ...]]:
        self.num_asked += 1
        self.is_there.wait(10.0)
        if host not in self.known:
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
        is_ipv6 = family == socket.AF_INET6
        return [
            (family, socket.SOCK_DGRAM, 17, "", (address, 0))
            for text in self.known[host]
            for address in [f"::ffff:{text}" if is_ipv6 and ":" not in text else text]
        ]


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[NameServer]:
    server = NameServer(right=["127.0.0.1"])
    monkeypatch.setattr(socket, "getaddrinfo", server.getaddrinfo)
    yield server
    server.is_there.set()


def test_heartbeats_wait_for_no_name_server(server: NameServer) -> None:
    """Each looked the name up: while no server answered, none went out to anybody."""
    server.is_there.clear()
    where, clock = Endpoint("127.0.0.1", free_port()), SystemClock()
    with (
        contextlib.closing(UdpDatagrams(clock, where)) as receiver,
        contextlib.closing(UdpDatagrams(clock)) as sender,
    ):
        began = clock.now()
        sender.send(BEAT, [("right", where.port), ("127.0.0.1", where.port)])
        assert clock.now() < began + 1.0
        assert len(receiver.receive(clock.now() + 1.0)) == 1
        server.is_there.set()

        def has_come() -> bool:
            sender.send(BEAT, [("right", where.port)])
            return bool(receiver.receive(clock.now() + 0.05))

        wait_until(has_come)
        asked = server.num_asked
        for _ in range(20):
            sender.send(BEAT, [("right", where.port)])
        assert server.num_asked <= asked + 1


def test_an_address_holds_while_no_server_answers_and_may_change(
    server: NameServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("poise.wire.host_names._AGAIN", 0.02)
    with contextlib.closing(HostNames(socket.AF_INET)) as names:
        wait_until(lambda: names.find("right") == ("127.0.0.1",))
        server.known.clear()
        asked = server.num_asked
        wait_until(lambda: server.num_asked > asked + 1)
        assert names.find("right") == ("127.0.0.1",)
        server.known["right"] = ["127.0.0.2"]
        wait_until(lambda: names.find("right") == ("127.0.0.2",))


def test_a_name_that_is_not_known_yet_is_looked_up_again(
    server: NameServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("poise.wire.host_names._SOON", 0.02)
    with contextlib.closing(HostNames(socket.AF_INET)) as names:
        assert names.find("10.0.0.1") == ("10.0.0.1",)
        assert server.num_asked == 0
        assert not names.find("left")
        wait_until(lambda: server.num_asked > 1)
        server.known["left"] = ["127.0.0.3"]
        wait_until(lambda: names.find("left") == ("127.0.0.3",))


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_heartbeats_reach_a_name_with_addresses_of_both_kinds(
    server: NameServer, host: str
) -> None:
    """By IPv4 alone, a robot whose names are in IPv6 never heard its agents.

    And at which of several addresses an agent listens, the name does not say.
    """
    server.known["both"] = ["::1", "127.0.0.2", "127.0.0.1"]
    where, clock = Endpoint(host, free_port()), SystemClock()
    with (
        contextlib.closing(UdpDatagrams(clock, where)) as receiver,
        contextlib.closing(UdpDatagrams(clock)) as sender,
    ):

        def has_come(name: str) -> bool:
            sender.send(BEAT, [(name, where.port)])
            return bool(receiver.receive(clock.now() + 0.05))

        assert has_come(host)
        wait_until(lambda: has_come("both"))
