"""Names of robots and computers, and hosts with TCP ports as text.

`arm_2`; `10.0.0.1`, `robot.local:7500`, `[fd00::2]:7447`.
"""

from __future__ import annotations

import re
from ipaddress import ip_address
from typing import Self

from msgspec import Struct

from poise.units import quoted

NAME = r"[A-Za-z][A-Za-z0-9_-]{0,62}"
NAME_SAYS = "a letter of a-z or A-Z, then up to 62 such letters, digits, '_' or '-'"

AGENT_PORT = 7447
"""The TCP port of an agent, unless it is given another one."""
_FORMS = "10.0.0.1, robot.local, fd00::2; with a port 10.0.0.1:7447 or [fd00::2]:7447"
_LAST_PORT = (1 << 16) - 1
_LABEL = r"(?!-)[A-Za-z0-9_-]{1,63}(?<!-)"
_NAME = re.compile(rf"{_LABEL}(\.{_LABEL})*\.?")
_LONGEST_NAME = 253
_BRACKETED = re.compile(r"\[(?P<host>[^][]*)\](?::(?P<port>.*))?")


class Endpoint(Struct, frozen=True):
    """A host (name or IP address, without brackets) and a TCP port."""

    host: str
    port: int

    @classmethod
    def parse(cls, text: str, port: int = AGENT_PORT) -> Self:
        """Return the endpoint in `text`, by default at `port`."""
        if bracketed := _BRACKETED.fullmatch(text):
            host, given = bracketed["host"], bracketed["port"]
            fault = "" if ":" in host else "only IPv6 addresses take brackets"
        elif text.count(":") > 1:
            host, given, fault = text, None, ""
        else:
            host, colon, rest = text.partition(":")
            given, fault = rest if colon else None, ""
        fault = fault or _host_fault(host) or _port_fault(given)
        if fault:
            raise ValueError(
                f"{quoted(text)} is not a valid address: {fault}; write {_FORMS}"
            )
        return cls(host, port if given is None else int(given))

    @property
    def is_ip(self) -> bool:
        """Whether the host is an IP address, which needs no look-up."""
        return _is_ip(self.host)

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{host}:{self.port}"


def is_loopback(host: str) -> bool:
    """Return whether only this computer reaches an address."""
    try:
        return ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


def _host_fault(host: str) -> str:
    if _is_ip(host):
        return _link_local_fault(host) if ":" in host else ""
    if ":" in host:
        return f"{quoted(host)} is not a valid IPv6 address"
    if re.fullmatch(r"[0-9.]+", host):
        return f"{quoted(host)} is not a valid IPv4 address"
    if len(host) > _LONGEST_NAME or not _NAME.fullmatch(host):
        return f"{quoted(host)} is not a valid host name"
    return ""


def _link_local_fault(host: str) -> str:
    if not ip_address(host).is_link_local:
        return ""
    return (
        f"{quoted(host)} is a link-local address, which each computer reaches through "
        "an interface of its own"
    )


def _port_fault(port: str | None) -> str:
    if port is None or (
        re.fullmatch(r"[0-9]{1,5}", port) and 0 < int(port) <= _LAST_PORT
    ):
        return ""
    return f"the port {quoted(port)} must be a number from 1 to {_LAST_PORT}"


def _is_ip(host: str) -> bool:
    try:
        ip_address(host)
    except ValueError:
        return False
    return True
