"""Where a container is reached: on this computer, or at the door of another."""

from __future__ import annotations

import re
import socket
from ipaddress import ip_address
from typing import Self

from msgspec import Struct

from poise.wire.codec import WireError

LOST_AFTER = 3.0
"""A computer that says nothing for so long is gone: its connections end [s]."""
_PROBE_EVERY = 1
_LAST_PORT = (1 << 16) - 1
_FORM = re.compile(r"(?:(?P<host>[^/]+):(?P<port>\d{1,5})/)?(?P<container>[\w.-]+)")


class Address(Struct, frozen=True):
    """Where a container is reached.

    Parameters
    ----------
    container
        Its name.
    host, port
        The IP address and TCP port of its computer's door; empty and 0: it is on this
        computer.
    """

    container: str
    host: str = ""
    port: int = 0

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return what `str` made a text of.

        Raises
        ------
        WireError
            It is no address.
        """
        found = _FORM.fullmatch(text)
        if found is not None:
            host, port = found["host"] or "", int(found["port"] or 0)
            if port <= _LAST_PORT and (not host or _is_ip(host)):
                return cls(found["container"], host, port)
        raise WireError(
            f"'{text}' is no address of a container: CONTAINER or "
            "IP-ADDRESS:PORT/CONTAINER"
        )

    def __str__(self) -> str:
        gateway = f"{self.host}:{self.port}/" if self.host else ""
        return f"{gateway}{self.container}"


def _is_ip(host: str) -> bool:
    try:
        ip_address(host)
    except ValueError:
        return False
    return True


def family_of(host: str) -> socket.AddressFamily:
    """Return the address family of an IP address."""
    return socket.AF_INET6 if ":" in host else socket.AF_INET


def tune(connection: socket.socket) -> None:
    """Let a TCP connection send at once, and end when its other end goes silent.

    That takes `LOST_AFTER`, and a second at most, while nothing was sent; else who uses
    the connection looks (`connection`). TCP's own limit for that would also end a
    connection to a process that only takes nothing for a while, and what was sent to it
    would be lost. What a listening socket is told holds for the connections that it
    accepts.
    """
    seconds = int(LOST_AFTER)
    for level, option, value in (
        (socket.IPPROTO_TCP, socket.TCP_NODELAY, 1),
        (socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1),
        (socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, _PROBE_EVERY),
        (socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, _PROBE_EVERY),
        (socket.IPPROTO_TCP, socket.TCP_KEEPCNT, seconds),
    ):
        connection.setsockopt(level, option, value)
