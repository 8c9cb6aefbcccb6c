"""Where an agent is and whom it knows: what it is started with."""

from __future__ import annotations

import os

from msgspec import Struct

from poise.wire.control_session import LEASE
from poise.wire.records.samples import SAMPLE_EVERY

BROKEN = os.EX_SOFTWARE
"""The exit code of an agent that an error of Poise ended: start it again."""


class AgentSetup(Struct, frozen=True, kw_only=True):
    """Where an agent is and whom it knows.

    Parameters
    ----------
    robot, computer
        Names.
    address
        IP address on which it and its containers listen.
    port
        TCP port of the agent.
    gateway
        TCP port for connections from other computers to its containers; 0: a free one.
    folder
        A folder of its own for sockets; the same one when it is started again.
    lifeline
        A file descriptor at whose end of file the agent ends; None: it runs on.
    lease
        Who is silent for this time [s] is lost.
    sample_every
        How often it tells what its containers count [s]; 0: never.
    """

    robot: str
    computer: str
    address: str
    port: int = 7447
    gateway: int = 0
    folder: str
    lifeline: int | None = None
    lease: float = LEASE
    sample_every: float = SAMPLE_EVERY
