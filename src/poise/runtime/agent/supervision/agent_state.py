"""What an agent keeps in its folder for the next one, in case it is killed."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from poise.wire.records.deployment import Deployment
from poise.wire.records.requests import PROTOCOL, ManagerId


class AgentState(Struct, frozen=True, kw_only=True):
    """What an agent must know after it was killed.

    Parameters
    ----------
    gateway
        Its IP address and TCP port.
    agents, is_leased
        With whom it exchanges heartbeats, as in `Claim`.
    boot
        When the computer has started since, nothing of it holds.
    """

    gateway: str = ""
    manager: ManagerId | None = None
    token: int = 0
    wanted: Deployment | None = None
    agents: Mapping[str, str] = {}
    is_leased: bool = False
    boot: str = ""
    protocol: int = PROTOCOL
