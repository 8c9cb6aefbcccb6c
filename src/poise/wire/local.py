"""Pipes between containers of one computer, over AF_UNIX and shared memory.

Every link carries one connector: its first frame names it. A call uses a link alone
until its answer is there, so that answers need no sorting and the thread that calls is
the thread that reads; callers at the same time use several. Messages use one link,
which keeps their order.
"""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import threading
import time
from pathlib import Path

from poise.errors import CallError, Timeout, Unavailable
from poise.wire import frame
from poise.wire.codec import WireError, codec
from poise.wire.frame import Frame, Kind
from poise.wire.link import Link
from poise.wire.pipe import LAST_LIMIT, Closed, Handler, Pieces, Refused, ignore
from poise.wire.underway import UnderWay

log = logging.getLogger(__name__)

_NAME = codec(str)
_ACCEPT_LIMIT = 1.0
_PAUSE = 0.01
_SPARE = 8
"""Links kept open per connector when no call uses them."""
_MOST_LINKS = 256
"""Links that a container serves at a time; more are closed at once."""
_SHORTEST = 1e-6


class LocalPipe:
    """The sending end; connects when first used, and again when the peer came back."""

    def __init__(self, connector: str, address: str) -> None:
        self._connector = connector
        self._address = address
        self._spare: list[Link] = []
        self._push_link: list[Link] = []
        self._most = _SPARE
        self._is_closed = False
        self._push_lock = threading.Lock()

    def is_ready(self) -> bool:
        """Return whether the receiving end is there, by connecting to it."""
        if any(link.is_idle() for link in [*self._spare, *self._push_link]):
            return True
        try:
            self._give_back(self._connect(_ACCEPT_LIMIT))
        except CallError:
            return False
        return True

    def request(self, pieces: Pieces, limit: float) -> Frame:
        """Send a call and wait for its answer (`poise.wire.pipe.Pipe.request`)."""
        if self._is_closed:
            raise Closed(f"{self._connector} is closed")
        deadline = time.monotonic() + limit
        link = self._send(self._spare, pieces, limit)
        try:
            answer = link.receive(deadline - time.monotonic())
        except BaseException:
            link.close()
            raise
        self._give_back(link)
        return answer

    def push(self, pieces: Pieces, limit: float) -> None:
        """Send a message; all use one link, which keeps their order."""
        deadline = time.monotonic() + limit
        if not self._push_lock.acquire(timeout=limit):
            raise Timeout(f"{self._connector}: others send since {limit:g} s")
        try:
            left = deadline - time.monotonic()
            link = self._send(self._push_link, pieces, left)
            if self._most:
                self._push_link.append(link)
            else:
                link.close()
        finally:
            self._push_lock.release()

    def close(self) -> None:
        """Send no more; links in use are closed when their call is over."""
        self._is_closed = True
        self._most = 0
        with self._push_lock:
            while self._push_link:
                self._push_link.pop().close()
        while self._spare:
            self._spare.pop().close()

    def _send(self, spare: list[Link], pieces: Pieces, limit: float) -> Link:
        """Send over a spare link or else a new one, and return it."""
        limit = max(limit, _SHORTEST)
        while True:
            try:
                link, is_spare = spare.pop(), True
            except IndexError:
                link, is_spare = self._connect(limit), False
            try:
                link.set_limit(limit)
                link.send(pieces, limit)
            except Unavailable:
                link.close()
                if not is_spare:
                    raise
                # the receiver closed it while it was idle, and has got nothing
            except BaseException:
                link.close()
                raise
            else:
                return link

    def _give_back(self, link: Link) -> None:
        if len(self._spare) < self._most:
            self._spare.append(link)
        else:
            link.close()

    def _connect(self, limit: float) -> Link:
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        link = Link(connection)
        try:
            link.set_limit(limit)
            connection.connect(self._address)
            link.send(frame.segments(_NAME, self._connector, Kind.WELCOME), limit)
            self._raise_if_refused(link.receive(limit))
        except OSError as error:
            link.close()
            raise Unavailable(
                f"{self._connector}: nobody at {self._address}"
            ) from error
        except WireError as error:
            link.close()
            raise Unavailable(f"{self._connector}: {error}") from error
        except BaseException:
            link.close()
            raise
        return link

    def _raise_if_refused(self, answer: Frame) -> None:
        if answer.kind is not Kind.WELCOME:
            raise Unavailable(f"{self._connector}: {answer.value(_NAME)}")


class LocalServer:
    """The receiving ends of a container: one socket, a thread per link."""

    def __init__(self, path: Path) -> None:
        self._handlers: dict[str, Handler] = {}
        self._refused: dict[str, Refused] = {}
        self._links: set[Link] = set()
        self._under_way = UnderWay()
        self._lock = threading.Lock()
        self._path = path
        self._closed = threading.Event()
        with contextlib.suppress(FileNotFoundError):
            path.unlink()
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.bind(os.fspath(path))
        self._listener.listen(64)
        threading.Thread(target=self._accept, name="accept", daemon=True).start()

    def open(self, connector: str, handler: Handler, refused: Refused = ignore) -> None:
        """Receive the frames of `connector` from now on."""
        self._refused[connector] = refused
        self._handlers[connector] = handler

    def shut(self, connector: str) -> None:
        """Receive no more of them; connections to it end at their next frame."""
        self._handlers.pop(connector, None)
        self._refused.pop(connector, None)

    def close(self) -> None:
        """Close the socket and every connection."""
        self._handlers.clear()
        self._under_way.wait_none(LAST_LIMIT)
        self._closed.set()
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        with self._lock:
            for link in self._links:
                link.end()
        self._path.unlink(missing_ok=True)

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                if self._closed.wait(_PAUSE):
                    return
                continue  # one that gave up, or no descriptor is free at the moment
            self._start(Link(connection))

    def _start(self, link: Link) -> None:
        with self._lock:
            is_full = len(self._links) >= _MOST_LINKS
            if not is_full:
                self._links.add(link)
        if is_full:
            log.warning("%s: more than %d links", self._path.name, _MOST_LINKS)
            link.close()
            return
        threading.Thread(
            target=self._serve, args=(link,), name="local", daemon=True
        ).start()

    def _serve(self, link: Link) -> None:
        connector = "unknown"
        try:
            connector = self._greet(link)
            while self._serve_one(connector, link):
                pass
        except WireError as error:
            log.warning("connector %s: refused: %s", connector, error)
        except (Unavailable, Timeout):
            pass
        finally:
            with self._lock:
                self._links.discard(link)
            link.close()

    def _greet(self, link: Link) -> str:
        link.set_limit(_ACCEPT_LIMIT)
        try:
            name: str = link.receive(_ACCEPT_LIMIT).value(_NAME)
            self._raise_if_unknown(name)
        except (WireError, Unavailable) as error:
            link.send(frame.segments(_NAME, str(error), Kind.ERROR))
            raise
        link.send(frame.segments(_NAME, name, Kind.WELCOME))
        link.receive_without_limit()
        return name

    def _raise_if_unknown(self, connector: str) -> None:
        if connector not in self._handlers:
            # usual while a robot starts: the sender asks again
            raise Unavailable(f"no connector '{connector}' ends here")

    def _serve_one(self, connector: str, link: Link) -> bool:
        try:
            received = link.receive()
        except WireError as error:
            # nothing behind it can be read, but whoever waits learns why
            self._refused.get(connector, ignore)(error)
            link.send(frame.failure("WireError", str(error)))
            raise
        with self._under_way:
            handler = self._handlers.get(connector)
            if handler is None:
                return False
            answer = handler(received)
            del received  # its shared memory may be used again
            if answer is not None:
                link.send(answer)
            return True
