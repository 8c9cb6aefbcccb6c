"""The address of a container: on this computer, or behind the gateway of another."""

from __future__ import annotations

import re
import socket
from typing import Self

from msgspec import Struct

from poise.endpoint import Endpoint
from poise.wire.codec import WireError

LOST_AFTER = 3.0
"""A computer that is silent for this time is lost: its connections end [s]."""
_PROBE_EVERY = 1
_CONTAINER = re.compile(r"[\w.-]+")


class Address(Struct, frozen=True):
    """The address of a container."""

    container: str  # Its name
    # The gateway of its computer; None: it is on this computer
    gateway: Endpoint | None = None

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the address that `str` gives as `text`."""
        before, slash, container = text.rpartition("/")
        if _CONTAINER.fullmatch(container):
            if not slash:
                return cls(container)
            try:
                gateway = Endpoint.parse(before, port=0)
            except ValueError:
                gateway = Endpoint("", 0)
            if gateway.is_ip and gateway.port:
                return cls(container, gateway)
        raise WireError(
            f"'{text}' is no address of a container: CONTAINER or "
            "IP-ADDRESS:PORT/CONTAINER"
        )

    def __str__(self) -> str:
        return f"{self.gateway}/{self.container}" if self.gateway else self.container


def family_of(host: str) -> socket.AddressFamily:
    """Return the address family of an IP address."""
    return socket.AF_INET6 if ":" in host else socket.AF_INET


def tune(connection: socket.socket) -> None:
    """Make TCP send at once, and end when silent for `LOST_AFTER`."""
    seconds = int(LOST_AFTER)
    for level, option, value in (
        (socket.IPPROTO_TCP, socket.TCP_NODELAY, 1),
        (socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1),
        (socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, _PROBE_EVERY),
        (socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, _PROBE_EVERY),
        (socket.IPPROTO_TCP, socket.TCP_KEEPCNT, seconds),
    ):
        connection.setsockopt(level, option, value)
