"""Pipes between containers of one computer, over AF_UNIX and shared memory.

Every link carries one connector: its first frame names it, and says whether calls or
messages follow. A call uses a link alone until its answer is there, so that answers
need no sorting and the thread that calls is the thread that reads; callers at the same
time use several. The thread that reads a call at the other end runs it and answers: no
thread wakes another. Messages use one link, which keeps their order. When it breaks and
another takes its place, the receiver first takes all that came over the first.
"""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from msgspec import Struct

from poise.errors import CallError, Timeout, Unavailable
from poise.wire import frame, stream
from poise.wire.codec import WireError, codec
from poise.wire.frame import Frame, Kind
from poise.wire.link import Link
from poise.wire.pipe import (
    LAST_LIMIT,
    MOST_UNREAD,
    Closed,
    Handler,
    Pieces,
    Refused,
    ignore,
)

log = logging.getLogger(__name__)

_NAME = codec(str)
_MESSAGES = 1
"""The number in the first frame of a link for messages; 0 for calls."""
_ACCEPT_LIMIT = 1.0
_ANSWER_LIMIT = 10.0
"""A caller that does not take its answer for so long is given up [s]."""
_PAUSE = 0.01
_PATIENCE = 1.0
"""While older messages are taken, this is told so often [s]."""
_SPARE = 8
"""Links kept open per connector when no call uses them."""
_IDLE = 30.0
"""Links that nobody used for so long are closed, with their shared memory [s]."""
_MOST_LINKS = 256
"""Links that a container serves at a time; more are closed at once."""


class _Spare:
    """Open links that nobody uses; what is long unused is closed."""

    def __init__(self) -> None:
        self._recent: list[Link] = []
        self._older: list[Link] = []
        self._is_closed = False

    def __iter__(self) -> Iterator[Link]:
        return iter([*self._recent, *self._older])

    def take(self) -> Link | None:
        """Return the one that was used last."""
        try:
            return self._recent.pop() if self._recent else self._older.pop()
        except IndexError:  # also when another thread was quicker
            return None

    def give_back(self, link: Link) -> None:
        """Keep one more, or close it."""
        if len(self._recent) >= _SPARE:
            link.close()
            return
        self._recent.append(link)
        if self._is_closed:  # perhaps just now
            self.close()

    def close_older(self) -> None:
        """Close those that nobody used since the last time."""
        _close_all(self._older)
        self._older, self._recent = self._recent, []

    def close(self) -> None:
        """Close all, and what is given back from now on."""
        self._is_closed = True
        _close_all(self._recent)
        _close_all(self._older)


def _close_all(links: list[Link]) -> None:
    with contextlib.suppress(IndexError):  # others may take some meanwhile
        while True:
            links.pop().close()


class LocalPipe:
    """The sending end; connects when first used, and again when the peer came back."""

    def __init__(self, connector: str, address: str) -> None:
        self._connector = connector
        self._address = address
        self._calls = _Spare()
        self._messages = _Spare()
        self._is_closed = False
        self._push_lock = threading.Lock()
        self._looked_at = time.monotonic()

    def is_ready(self) -> bool:
        """Return whether the receiving end is there, by connecting to it.

        Who asks now and then lets go of what has become idle.
        """
        now = time.monotonic()
        if now - self._looked_at > _IDLE:
            self._looked_at = now
            self._calls.close_older()
            self._messages.close_older()
        if any(link.is_idle() for link in [*self._calls, *self._messages]):
            return True
        try:
            self._calls.give_back(self._connect(0, now + _ACCEPT_LIMIT))
        except CallError:
            return False
        return True

    def request(self, pieces: Pieces, limit: float) -> Frame:
        """Send a call and wait for its answer (`poise.wire.pipe.Pipe.request`)."""
        if self._is_closed:
            raise Closed(f"{self._connector} is closed")
        deadline = time.monotonic() + limit
        while True:
            found = self._calls.take()
            link = found or self._connect(0, deadline)
            try:
                answer = link.ask(pieces, deadline)
            except BaseException:
                # also when a signal's handler raises: the answer may still come, and
                # the next call must not take it for its own
                link.close()
                raise
            if answer is not None:
                self._calls.give_back(link)
                return answer
            link.close()  # the receiver had done so while it was idle
            if found is None:
                raise Unavailable(f"{self._connector}: {self._address} went away")

    def push(self, pieces: Pieces, limit: float) -> None:
        """Send a message; all use one link, which keeps their order."""
        deadline = time.monotonic() + limit
        if not self._push_lock.acquire(timeout=limit):
            raise Timeout(f"{self._connector}: others send since {limit:g} s")
        try:
            self._messages.give_back(self._send(pieces, deadline))
        finally:
            self._push_lock.release()

    def close(self) -> None:
        """Send no more; links in use are closed when their call is over."""
        self._is_closed = True
        with self._push_lock:
            self._messages.close()
        self._calls.close()

    def _send(self, pieces: Pieces, deadline: float) -> Link:
        """Send a message over the link for them or else a new one, and return it."""
        while True:
            found = self._messages.take()
            link = found or self._connect(_MESSAGES, deadline)
            try:
                link.send(pieces, deadline)
            except Unavailable:
                link.close()
                if found is None:
                    raise
                # the receiver closed it while it was idle, and has got nothing
            except BaseException:
                # also when a signal's handler raises: part of it may have been sent
                link.close()
                raise
            else:
                return link

    def _connect(self, use: int, deadline: float) -> Link:
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        link = Link(connection)
        hello = frame.segments(_NAME, self._connector, Kind.WELCOME, number=use)
        try:
            stream.set_limit(connection, max(deadline - time.monotonic(), 0.0))
            connection.connect(self._address)
            link.send(hello, deadline)
            self._raise_if_refused(link.receive(deadline))
        except OSError as error:
            link.close()
            raise Unavailable(
                f"{self._connector}: nobody at {self._address}"
            ) from error
        except WireError as error:
            link.close()
            raise Unavailable(f"{self._connector}: {error}") from error
        except BaseException:
            # also when a signal's handler raises: nobody else knows of it yet
            link.close()
            raise
        return link

    def _raise_if_refused(self, answer: Frame) -> None:
        if answer.kind is not Kind.WELCOME:
            raise Unavailable(f"{self._connector}: {answer.value(_NAME)}")


class _Served(Struct, eq=False):
    """A link of a server, and the thread that takes what comes over it."""

    link: Link
    thread: threading.Thread


class LocalServer:
    """The receiving ends of a container: one socket, a thread per link."""

    def __init__(self, path: Path) -> None:
        self._handlers: dict[str, Handler] = {}
        self._refused: dict[str, Refused] = {}
        self._links: set[_Served] = set()
        self._messages: dict[str, _Served] = {}
        self._lock = threading.Lock()
        self._path = path
        self._closed = threading.Event()
        with contextlib.suppress(FileNotFoundError):
            path.unlink()
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.bind(os.fspath(path))
        self._listener.listen(64)
        threading.Thread(target=self._accept, name="accept", daemon=True).start()

    def open(
        self,
        connector: str,
        handler: Handler,
        refused: Refused = ignore,
        most: int = MOST_UNREAD,  # noqa: ARG002, the socket keeps what is not read
        *,
        calls: bool = True,  # noqa: ARG002, it costs nothing to take them
    ) -> None:
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
        self._closed.set()
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        with self._lock:
            links = list(self._links)
        for served in links:
            served.link.end(socket.SHUT_RD)  # calls that came are answered still
        deadline = time.monotonic() + LAST_LIMIT
        for served in links:
            if served.thread is not threading.current_thread():
                served.thread.join(max(0.0, deadline - time.monotonic()))
            served.link.end()
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
        served = _Served(link, threading.current_thread())
        served.thread = threading.Thread(
            target=self._serve, args=(served,), name="local", daemon=True
        )
        with self._lock:
            is_full = len(self._links) >= _MOST_LINKS
            if not is_full and not self._closed.is_set():
                self._links.add(served)
                served.thread.start()
                return
        if is_full:
            log.warning("%s: more than %d links", self._path.name, _MOST_LINKS)
        link.close()

    def _serve(self, served: _Served) -> None:
        connector = "unknown"
        try:
            connector = self._greet(served)
            while self._serve_one(connector, served.link):
                pass
        except WireError as error:
            log.warning("connector %s: refused: %s", connector, error)
        except (Unavailable, Timeout):
            pass
        finally:
            with self._lock:
                self._links.discard(served)
                if self._messages.get(connector) is served:
                    del self._messages[connector]
            served.link.close()

    def _greet(self, served: _Served) -> str:
        link, deadline = served.link, time.monotonic() + _ACCEPT_LIMIT
        try:
            hello = link.receive(deadline)
            name: str = hello.value(_NAME)
            self._raise_if_unknown(name)
        except (WireError, Unavailable) as error:
            link.send(frame.segments(_NAME, str(error), Kind.ERROR), deadline)
            raise
        before = None
        if hello.number == _MESSAGES:
            before = self._messages.get(name)
            self._messages[name] = served
        link.send(frame.segments(_NAME, name, Kind.WELCOME), deadline)
        if before is not None:
            _wait_until_taken(name, before)
        return name

    def _raise_if_unknown(self, connector: str) -> None:
        if connector not in self._handlers:
            # usual while a robot starts: the sender asks again
            raise Unavailable(f"no connector '{connector}' ends here")

    def _serve_one(self, connector: str, link: Link) -> bool:
        try:
            received = link.receive()
        except WireError as error:
            # nothing behind it can be read, but whoever waits learns why; the sender
            # must not take the link for its next frame when it has
            self._refused.get(connector, ignore)(error)
            link.end(socket.SHUT_RD)
            link.send(_refusal(error), time.monotonic() + _ANSWER_LIMIT)
            raise
        handler = self._handlers.get(connector)
        if handler is None:
            return False
        answer = handler(received)
        del received  # its shared memory may be used again
        if answer is not None:
            deadline = time.monotonic() + _ANSWER_LIMIT
            try:
                link.send(answer, deadline)
            except WireError as error:  # it is too large
                link.send(_refusal(error), deadline)
        return True


def _refusal(error: WireError) -> Pieces:
    return frame.failure("WireError", str(error))


def _wait_until_taken(connector: str, before: _Served) -> None:
    """Wait until all came that was sent over the link before, which its sender left.

    Else a message could overtake those that were sent earlier. It ends, because each of
    them waits for room in a queue for a limited time, and then is dropped.
    """
    before.link.end(socket.SHUT_RD)
    while before.thread.is_alive():
        before.thread.join(_PATIENCE)
        log.info("connector %s: older messages are still being taken", connector)
