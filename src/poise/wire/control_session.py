"""Zenoh sessions, over which the manager and the agents communicate."""

from __future__ import annotations

import json
import re
import socket
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import zenoh

from poise import threads
from poise.endpoint import Endpoint
from poise.errors import RunError

if TYPE_CHECKING:
    from poise.wire.credentials import Credentials

SESSION_TIMEOUT = 2.0
"""A zenoh session with a peer that is silent for longer ends [s]. TCP sends again after
waits that double, so a cut of 0.5 s may silence it for 1.5 s."""
UNCUT_SESSION_TIMEOUT = 10.0
"""The same of peers that nothing can cut off, but that may have to wait for CPU."""

_GIVEN_UP_AFTER = "transport/link/tx/queue/congestion_control/block/wait_before_close"

COMMAND_LIMIT = 60.0
"""A manager answers within this time [s]; moves of large states take the longest."""
_CLOSE_LIMIT = 0.1
_NO_LINGER = struct.pack("ii", 0, 0)


def open_session(
    *,
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    timeout: float = SESSION_TIMEOUT,
    keys: Credentials | None = None,
    serves: str = "",
) -> zenoh.Session:
    """Open a zenoh session as a peer that connects only to given peers.

    With `keys` only peers with a certificate of the same robot are let in. What they
    may ask of an agent, which `serves` a robot, depends on their role.
    """
    settings: dict[str, object] = {
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
        "transport/link/tx/lease": int(timeout * 1000),
        # a peer that takes nothing of a large message is given up before its lease
        # ends: zenoh would then close it, and send nothing to any peer until it gave up
        _GIVEN_UP_AFTER: int(timeout * 1e6 / 2),
        # shared memory would pass through network namespaces, and between containers
        # of one computer Poise has better
        "transport/shared_memory/enabled": False,
    }
    if keys is not None:
        settings |= keys.zenoh()
        # zenoh takes what is before the port for a name in TLS: none has brackets
        settings["connect/endpoints"] = [re.sub(r"[][]", "", each) for each in connect]
        # refused handshakes are said on stderr
        zenoh.init_log_from_env_or("zenoh_link_tls::unicast=warn")
        if serves:
            settings["access_control"] = _access(serves)
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
    except BaseException as error:  # a panic of Rust is no Exception
        if "can't spawn" not in str(error):
            raise
        raise RunError(threads.NO_THREAD) from None
    try:
        session.info.declare_link_events_listener(_close_without_waiting, history=True)
    except BaseException:
        close_session(session)  # this process would not end before its threads
        raise
    return session


def close_session(session: zenoh.Session) -> None:
    """Close a session, in the background if that takes longer than a moment.

    zenoh waits for up to 10 s for a connection that it is opening, to a lost computer.
    """
    closing = threads.daemon(session.close, "closing")
    try:
        closing.start()
    except RuntimeError:  # no thread is free
        closing.run()
        return
    closing.join(_CLOSE_LIMIT)
    if closing.is_alive():
        threads.abandon(closing)


_LOOKS = (
    "put",
    "delete",
    "reply",
    "declare_subscriber",
    "declare_queryable",
    "declare_liveliness_subscriber",
    "liveliness_query",
)
"""Messages of zenoh that pass between an agent and a peer that looks."""


def _access(robot: str) -> dict[str, object]:
    """Return what an agent allows: all to a manager; to a viewer, to see its news."""

    def rule(
        name: str, flows: Sequence[str], messages: Sequence[str]
    ) -> dict[str, object]:
        keys = [f"poise/{robot}/**", IDENTITIES]
        return {
            "id": name,
            "permission": "allow",
            "flows": flows,
            "messages": messages,
            "key_exprs": keys,
        }

    both, commands = ("ingress", "egress"), ("query", "liveliness_token")
    rules = {
        "manager": [rule("command", both, [*_LOOKS, *commands])],
        "viewer": [
            rule("look", both, _LOOKS),
            rule("see who is there", ["egress"], ["liveliness_token"]),
        ],
    }
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [each for of_role in rules.values() for each in of_role],
        "subjects": [{"id": role, "cert_common_names": [role]} for role in rules],
        "policies": [
            {"rules": [each["id"] for each in of_role], "subjects": [role]}
            for role, of_role in rules.items()
        ],
    }


def _close_without_waiting(event: zenoh.LinkEvent) -> None:
    """Let the kernel close links in the background.

    zenoh waits up to 10 s for each, on the threads that receive from all peers.
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
            if _locators(ends) == (_address(link.src), _address(link.dst)):
                yield link_socket
        except OSError:  # not connected
            continue
        finally:
            link_socket.detach()


def _locators(ends: Sequence[object]) -> tuple[str, ...]:
    """Return zenoh's names of the ends of a TCP connection, without the protocol."""
    return tuple(str(Endpoint(*end[:2])) for end in ends if isinstance(end, tuple))


def _address(locator: str) -> str:
    return locator.partition("/")[2]


IDENTITIES = "poise-agent/**"
"""The liveliness tokens by which the agents of all robots say who they are."""


def identity_key(locator: str, robot: str, computer: str) -> str:
    """Return the key of an agent's token; `parse_identity` takes it apart."""
    return f"poise-agent/{locator}/{robot}/{computer}"


def parse_identity(key: str) -> tuple[str, str, str]:
    """Return the locator, robot and computer of an agent."""
    locator, robot, computer = key.removeprefix("poise-agent/").rsplit("/", 2)
    return locator, robot, computer


def locator(agent: Endpoint, keys: Credentials | None = None) -> str:
    """Return zenoh's name of an agent's address."""
    return f"tls/{agent}" if keys is not None else f"tcp/{agent}"


def endpoint_of(locator: str) -> Endpoint:
    """Return an agent's address from zenoh's name of it."""
    return Endpoint.parse(_address(locator))
