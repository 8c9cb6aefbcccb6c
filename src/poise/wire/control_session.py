"""Zenoh sessions, over which the manager and the agents communicate."""

from __future__ import annotations

import json
import re
import socket
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path

import zenoh

from poise.endpoint import Endpoint
from poise.errors import RunError

LEASE = 2.0
"""A manager or an agent that is cut off counts as out of reach after this time [s]. TCP
sends again after waits that double, so a cut of 0.5 s may silence it for 1.5 s."""

_NO_LINGER = struct.pack("ii", 0, 0)


def open_session(
    *,
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    lease: float = 10.0,
) -> zenoh.Session:
    """Open a zenoh session as a peer that connects only to given peers."""
    settings = {
        "mode": "peer",
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        # retry for ever, to find a peer again that restarts
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {
            "period_init_ms": 50,
            "period_max_ms": 500,
            "period_increase_factor": 2,
        },
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "open/return_conditions/connect_scouted": False,
        "transport/link/tx/lease": int(lease * 1000),
        # shared memory would pass through network namespaces, and between containers
        # of one computer Poise has better
        "transport/shared_memory/enabled": False,
    }
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        # without zenoh's source location
        cause = re.search(r"[^:\[]+\(os error \d+\)", str(error))
        why = cause.group().strip() if cause else str(error)
        raise RunError(f"cannot listen on {', '.join(listen)}: {why}") from None
    session.info.declare_link_events_listener(_close_without_waiting, history=True)
    return session


def _close_without_waiting(event: zenoh.LinkEvent) -> None:
    """Let the kernel close links in the background.

    zenoh closes them with SO_LINGER of 10 s on the threads that receive from all peers:
    one peer that is cut off would silence all others.
    """
    if event.kind == zenoh.SampleKind.PUT:
        for link in _sockets(event.link):
            link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _NO_LINGER)


def _sockets(link: zenoh.Link) -> Iterator[socket.socket]:
    """Yield this process's socket of a link, without taking it from zenoh."""
    for descriptor in list(Path("/proc/self/fd").iterdir()):
        try:
            link_socket = socket.socket(fileno=int(descriptor.name))
        except OSError:  # no socket, or closed
            continue
        try:
            ends = link_socket.getsockname(), link_socket.getpeername()
            if _locators(ends) == (link.src, link.dst):
                yield link_socket
        except OSError:  # not connected
            continue
        finally:
            link_socket.detach()


def _locators(ends: Sequence[object]) -> tuple[str, ...]:
    """Return zenoh's names of the ends of a TCP connection."""
    return tuple(locator(Endpoint(*end[:2])) for end in ends if isinstance(end, tuple))


IDENTITIES = "poise-agent/**"
"""The liveliness tokens by which the agents of all robots say who they are."""


def identity_key(locator: str, robot: str, computer: str) -> str:
    """Return the key of an agent's token; `parse_identity` takes it apart."""
    return f"poise-agent/{locator}/{robot}/{computer}"


def parse_identity(key: str) -> tuple[str, str, str]:
    """Return the locator, robot and computer of an agent."""
    locator, robot, computer = key.removeprefix("poise-agent/").rsplit("/", 2)
    return locator, robot, computer


def locator(agent: Endpoint) -> str:
    """Return zenoh's name of an agent's address."""
    return f"tcp/{agent}"


def endpoint_of(locator: str) -> Endpoint:
    """Return an agent's address from zenoh's name of it."""
    return Endpoint.parse(locator.removeprefix("tcp/"))
