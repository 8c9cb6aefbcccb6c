"""Zenoh sessions, over which the manager and the agents communicate."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence

import zenoh

from poise.endpoint import Endpoint
from poise.errors import RunError

LEASE = 2.0
"""A manager or an agent that is cut off counts as out of reach after this time [s]. TCP
sends again after waits that double, so a cut of 0.5 s may silence it for 1.5 s."""


def open_session(
    *,
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    gossip: bool = True,
    lease: float = 10.0,
) -> zenoh.Session:
    """Open a zenoh session as a peer that connects only to given peers.

    Parameters
    ----------
    listen, connect
        zenoh endpoints, such as ``tcp/10.0.0.2:7447``.
    gossip
        Whether it also connects to the peers of its peers.
    lease
        A link without traffic for this time is lost [s].

    Raises
    ------
    RunError
        It cannot listen on an address: not this computer's, or in use.
    """
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
        "scouting/gossip/enabled": gossip,
        # with it, all peers announce each new peer to all others (with 11 peers: 10 ms
        # of CPU on each instead of 2)
        "scouting/gossip/multihop": False,
        "scouting/gossip/autoconnect_strategy": {
            "peer": {"to_router": "always", "to_peer": "greater-zid"}
        },
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
        return zenoh.open(config)
    except zenoh.ZError as error:
        # without zenoh's source location
        said = re.search(r"[^:\[]+\(os error \d+\)", str(error))
        why = said.group().strip() if said else str(error)
        raise RunError(f"cannot listen on {', '.join(listen)}: {why}") from None


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
