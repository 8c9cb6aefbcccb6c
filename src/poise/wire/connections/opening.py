"""How a connection begins: the sending end names the connector, the other accepts."""

from __future__ import annotations

import errno
import logging
import os
import resource
import select
import socket
import time
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from poise.errors import Sparing, Unavailable
from poise.wire import frame
from poise.wire.address import KEYS, LOST_AFTER, Address, family_of, socket_path, tune
from poise.wire.codec import WireError, codec
from poise.wire.connections.connection import Connection
from poise.wire.frame import FrameKind

if TYPE_CHECKING:
    from poise.wire.connections.tls_channel import Handshake
    from poise.wire.credentials import Credentials, RenewableKeys

NAME = codec(str)
NOT_HERE = "its other end is not here: it starts, moves or has ended"
CALLS, MESSAGES = 0, 1
"""The use of a connection: the number in the frame that names the connector."""
ANSWER_LIMIT = LOST_AFTER
"""A container that is there accepts a connection within this time [s]."""
_RETRY, _REMOTE_RETRY = 0.005, 0.2
"""It connects again after this time, and then after twice the time [s]: to a container
whose queue is full, and to a computer that is silent. The kernel repeats a lost SYN
only after 1, 3 and 7 s: too late after a short cut."""
_LONGEST_WAIT = 1e6
"""`poll` takes no number of milliseconds over 2^31 [s]."""


@cache
def renewable_keys() -> RenewableKeys | None:
    """Return the keys of this process as they are renewed; None: it has none."""
    if not os.environ.get(KEYS):
        return None
    from poise.wire.credentials import RenewableKeys  # noqa: PLC0415, `ssl` is slow

    return RenewableKeys(Path(os.environ[KEYS]))


def own_keys() -> Credentials | None:
    """Return the keys of this process; None: it meets other computers over TCP."""
    keys = renewable_keys()
    return None if keys is None else keys.latest()


class Opening:
    """A connection that is being opened, without a thread that waits for it."""

    def __init__(self, connector: str, address: Address, folder: Path) -> None:
        self._connector = connector
        self._address = address
        self._folder = folder
        self._keys = own_keys() if address.gateway else None
        self._handshake: Handshake | None = None
        self._has_reached = self._has_asked = False
        self._give_up_at = time.monotonic() + ANSWER_LIMIT
        self._patience = _REMOTE_RETRY if address.gateway else _RETRY
        self._closing = ExitStack()
        try:
            self._begin()
        except BaseException as error:
            raise self._failed(error) from error

    def go_on(self, use: int, deadline: float) -> bool:
        """Go on until it is open or `deadline` comes; return whether it is open."""
        try:
            return (
                self._is_connected(deadline)
                and self._is_asked(use, deadline)
                and self._is_accepted(deadline)
            )
        except BaseException as error:
            raise self._failed(error) from error

    def is_late(self) -> bool:
        """Return whether the other end had enough time."""
        return time.monotonic() > self._give_up_at

    def close(self) -> None:
        """Give it up."""
        self._closing.close()

    def _begin(self) -> None:
        self.close()
        gateway = self._address.gateway
        family = family_of(gateway.host) if gateway else socket.AF_UNIX
        self._socket = socket.socket(family, socket.SOCK_STREAM)
        self._closing.callback(self._socket.close)
        self.connection = Connection(self._socket)
        self._retry_at = time.monotonic() + self._patience
        self._patience *= 2
        self._socket.setblocking(False)
        if gateway:
            tune(self._socket)
            error = self._socket.connect_ex((gateway.host, gateway.port))
        else:
            path = socket_path(self._folder, self._address.container)
            error = self._socket.connect_ex(os.fspath(path))
        self._is_queue_full = error == errno.EAGAIN
        if not self._is_queue_full:
            _raise_if(error)

    def _is_connected(self, deadline: float) -> bool:
        while not self._has_reached:
            # of a socket that is not even connecting, `poll` says that it is ready
            event = 0 if self._is_queue_full else select.POLLOUT
            if self._is_ready(event, min(deadline, self._retry_at)):
                _raise_if(self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR))
                self._has_reached = True
                if self._address.gateway:
                    self._say(self._address.container)
            elif time.monotonic() < self._retry_at:
                return False
            else:
                self._begin()
        return True

    def _is_asked(self, use: int, deadline: float) -> bool:
        if not self._has_asked:
            if self._keys is not None and not self._is_secured(self._keys, deadline):
                return False
            self._say(self._connector, use)
            self._has_asked = True
        return True

    def _is_secured(self, keys: Credentials, deadline: float) -> bool:
        from poise.wire.connections.tls_channel import Handshake  # noqa: PLC0415

        try:
            if self._handshake is None:
                self._handshake = Handshake(self._socket, keys, accepts=False)
                self._socket = self._handshake.socket
                self._closing.callback(self._socket.close)
            while not self._handshake.go_on():
                if not self._is_ready(self._handshake.event, deadline):
                    return False
        except Unavailable as error:
            raise Unavailable(f"{self._connector}: {error}") from error
        self.connection.secure(self._handshake.socket)
        return True

    def _is_accepted(self, deadline: float) -> bool:
        if not self._is_ready(select.POLLIN, deadline):
            return False
        answer = self.connection.receive(time.monotonic() + ANSWER_LIMIT)
        if answer.kind is not FrameKind.HELLO:
            raise Unavailable(f"{self._connector}: {answer.value(NAME)}")
        return True

    def _say(self, name: str, number: int = 0) -> None:
        hello = frame.segments(NAME, name, FrameKind.HELLO, number=number)
        self.connection.send(hello, time.monotonic() + ANSWER_LIMIT)

    def _is_ready(self, event: int, deadline: float) -> bool:
        poll = select.poll()
        if event:
            poll.register(self._socket, event)
        left = min(max(0.0, deadline - time.monotonic()), _LONGEST_WAIT)
        return bool(poll.poll(1000 * left))

    def _failed(self, error: BaseException) -> BaseException:
        """Close it, and return the error for its user."""
        self.close()
        if isinstance(error, OSError):
            is_alone = isinstance(error, FileNotFoundError | ConnectionRefusedError)
            what = "nothing listens at" if is_alone else "no connection to"
            return Unavailable(f"{self._connector}: {what} {self._address}: {error}")
        if isinstance(error, WireError):
            return Unavailable(f"{self._connector}: {error}")
        return error


def _raise_if(error: int) -> None:
    if error not in {0, errno.EINPROGRESS}:
        raise OSError(error, os.strerror(error))


log = logging.getLogger(__name__)

_LATELY = 2.0
"""A failure counts for this time [s]: status is asked for more often."""
_PASSING = {errno.EAGAIN, errno.ECONNABORTED, errno.EINTR}


class AcceptWarning:
    """The warnings of one listener: logged now and then, reported while they last."""

    def __init__(self, who: str) -> None:
        self._who = who
        self._sparing = Sparing(log)
        self._last = ""
        self._last_at = float("-inf")

    def note(self, error: OSError | RuntimeError) -> None:
        """Warn that one was not accepted, unless the connection has just gone."""
        if isinstance(error, OSError) and error.errno in _PASSING:
            return
        self._last_at, self._last = time.monotonic(), self._sentence(error)
        self._sparing.warn("refused", "%s", self._last)

    def trouble(self) -> str:
        """Return why no connection can be accepted now; empty: they can."""
        try:
            os.close(os.eventfd(0))
        except OSError as error:
            return self._sentence(error)
        return self._last if time.monotonic() < self._last_at + _LATELY else ""

    def _sentence(self, error: OSError | RuntimeError) -> str:
        return f"{self._who} accepts no connection for now: {error}{_remedy(error)}"


def _remedy(error: OSError | RuntimeError) -> str:
    if not isinstance(error, OSError) or error.errno != errno.EMFILE:
        return ""
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return (
        f". Process {os.getpid()} may open {limit} files: raise that where the agent "
        f"starts (`ulimit -n {2 * limit}`), or close what its components leave open"
    )
