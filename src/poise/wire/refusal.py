"""Why an agent accepts no connections, which zenoh does not say."""

from __future__ import annotations

import contextlib
import socket
import ssl
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

from poise.endpoint import Endpoint
from poise.wire.credentials import Credentials

_MOST_AT_ONCE = 8
_LIMIT = 2.0
"""An agent that would say something has said it after this time [s]."""
_SMALL = 500
"""Segments of this size get through where an IPv4 packet of 576 bytes does."""
_NO_TLS = (
    "it does not answer in TLS: it hangs, runs with --insecure, or something else is "
    "there"
)
_ALERT = 0x15
"""How a TLS record begins that refuses."""
_STRANGE = b"\x01\x00\x00"
"""A frame of zenoh with nothing in it, which is no TLS record."""


def why_all_refused(
    agents: Mapping[str, Endpoint],
    keys: Credentials | None,
    *,
    if_not_there: bool = True,
) -> Mapping[str, str]:
    """Return agent -> why it refuses these keys, all asked at once; empty: unknown.

    `if_not_there`: also those at whose address nothing listens.
    """

    def why(name: str) -> str | None:
        try:
            return _of_listener(agents[name], keys)
        except OSError as error:
            return f"{agents[name]}: {error}" if if_not_there else None

    with ThreadPoolExecutor(_MOST_AT_ONCE) as pool:  # each may take seconds
        reasons = zip(agents, pool.map(why, agents), strict=True)
        return {name: reason for name, reason in reasons if reason is not None}


def _of_listener(agent: Endpoint, keys: Credentials | None) -> str:
    with socket.create_connection((agent.host, agent.port), _LIMIT) as plain:
        if keys is None:
            return _of_plain(plain)
        family, remote = plain.family, plain.getpeername()
        with contextlib.suppress(TimeoutError):
            return _of_keys(plain, keys)
    with socket.socket(family) as plain:
        plain.settimeout(_LIMIT)
        plain.setsockopt(socket.IPPROTO_TCP, socket.TCP_MAXSEG, _SMALL)
        plain.connect(remote)
        try:
            _of_keys(plain, keys)
        except TimeoutError:
            return _NO_TLS
    return (
        "small packets reach it, and larger ones do not: set the MTU of this computer "
        "or of its own to the smallest on the way, and let ICMP through"
    )


def _of_plain(plain: socket.socket) -> str:
    plain.sendall(_STRANGE)
    try:
        wants_keys = plain.recv(1) == bytes([_ALERT])
    except TimeoutError:
        wants_keys = False
    if not wants_keys:
        return (
            "something accepts connections there, but does not answer as an agent of "
            "this robot: does another program have its port, or does the agent hang?"
        )
    return (
        "it wants keys of this robot, and there are none here: `poise keys issue "
        "ROBOT NAME --role manager` makes them"
    )


def _of_keys(plain: socket.socket, keys: Credentials) -> str:
    try:
        secured = keys.client.wrap_socket(plain)
    except ssl.SSLCertVerificationError as error:
        if "not yet valid" in error.verify_message:
            return "its certificate does not hold yet: is this computer's clock right?"
        return (
            f"its certificate is not of this robot or has ended ({error.verify_message}"
            "): `poise keys issue` makes another"
        )
    except TimeoutError:
        raise
    except OSError:
        return _NO_TLS
    try:
        with secured:
            secured.recv(1)  # it says so only now that it does not trust ours
    except TimeoutError:
        return ""
    except OSError as error:
        reason = getattr(error, "reason", error)
        said = f"it refuses the keys in {keys.folder} ({reason})"
        # what has ended by this computer's clock is refused before anybody connects
        is_clock = "CERTIFICATE_EXPIRED" in str(reason)
        return f"{said}: is the clock of its computer right?" if is_clock else said
    return ""
