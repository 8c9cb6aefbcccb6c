"""How a link begins: the sending end says what it wants, and the other takes it.

A container of this computer is reached at its AF_UNIX socket, another at the door of
its computer (`gateway`), where a frame names the container first. Then a frame
names the connector, and its number says whether calls or messages will follow.
"""

from __future__ import annotations

import select
import socket
import time
from pathlib import Path

from poise.errors import Unavailable
from poise.wire import frame
from poise.wire.address import LOST_AFTER, Address, family_of, tune
from poise.wire.codec import WireError, codec
from poise.wire.connections import stream
from poise.wire.connections.connection import Connection
from poise.wire.connections.socket_path import socket_path
from poise.wire.frame import Kind

NAME = codec(str)
CALLS, MESSAGES = 0, 1
"""What a link is for: the number in the frame that names the connector."""
ANSWER_LIMIT = LOST_AFTER
"""Who is there takes a new link within this time [s]."""


class Opening:
    """A link that is being opened; nobody need wait for it.

    Raises
    ------
    Unavailable
        Nobody is there.
    """

    def __init__(self, connector: str, address: Address, folder: Path) -> None:
        self._connector = connector
        self._address = address
        self._asked = False
        self._give_up_at = time.monotonic() + ANSWER_LIMIT
        gateway = address.gateway
        family = family_of(gateway.host) if gateway else socket.AF_UNIX
        self._connection = socket.socket(family, socket.SOCK_STREAM)
        self.connection = Connection(self._connection)
        try:
            if gateway:
                tune(self._connection)
                self._connection.setblocking(False)
                self._connection.connect((gateway.host, gateway.port))
            else:
                stream.set_limit(self._connection, ANSWER_LIMIT)
                path = socket_path(folder, address.container)
                self._connection.connect(str(path))
        except BlockingIOError:
            pass  # under way
        except BaseException as error:
            raise self._failed(error) from error

    def go_on(self, use: int, deadline: float) -> bool:
        """Open it as far as that takes until `deadline`; return whether it is open.

        Raises
        ------
        Unavailable
            Nobody is there, or the link was refused.
        """
        try:
            return self._go_on(use, deadline)
        except BaseException as error:
            raise self._failed(error) from error

    def is_late(self) -> bool:
        """Return whether whoever is there had time enough."""
        return time.monotonic() > self._give_up_at

    def _go_on(self, use: int, deadline: float) -> bool:
        if not self._asked:
            if not self._waited(select.POLLOUT, deadline):
                return False
            error = self._connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
            if error:
                raise OSError(error, "")
            self._ask(use)
        if not self._waited(select.POLLIN, deadline):
            return False
        answer = self.connection.receive(time.monotonic() + ANSWER_LIMIT)
        if answer.kind is not Kind.HELLO:
            raise Unavailable(f"{self._connector}: {answer.value(NAME)}")
        return True

    def _ask(self, use: int) -> None:
        names = [(self._connector, use)]
        if self._address.gateway:
            names.insert(0, (self._address.container, 0))
        for name, number in names:
            hello = frame.segments(NAME, name, Kind.HELLO, number=number)
            self.connection.send(hello, time.monotonic() + ANSWER_LIMIT)
        self._asked = True

    def _waited(self, event: int, deadline: float) -> bool:
        poll = select.poll()
        poll.register(self._connection, event)
        left = deadline - time.monotonic()
        return bool(poll.poll(max(0.0, 1000 * left)))

    def _failed(self, error: BaseException) -> BaseException:
        """Close it, and return what its user is told."""
        self.connection.close()
        if isinstance(error, OSError):
            return Unavailable(f"{self._connector}: nobody at {self._address}")
        if isinstance(error, WireError):
            return Unavailable(f"{self._connector}: {error}")
        return error
