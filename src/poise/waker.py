"""Waiting for several things at once, and being woken while at it."""

from __future__ import annotations

import contextlib
import os
import select
from collections.abc import Collection, Iterable


class Waker:
    """Wakes a thread that waits for a pipe to be readable; then `clear` it."""

    def __init__(self) -> None:
        self._out, self._in = os.pipe()
        os.set_blocking(self._out, False)
        os.set_blocking(self._in, False)

    def fileno(self) -> int:
        """Return the file descriptor to wait for."""
        return self._out

    @property
    def signal_fd(self) -> int:
        """The file descriptor for ``signal.set_wakeup_fd``."""
        return self._in

    def wake(self) -> None:
        """Wake the waiting thread; never blocks."""
        with contextlib.suppress(BlockingIOError):  # then it is awake already
            os.write(self._in, b"!")

    def clear(self) -> None:
        """Forget all wakes so far."""
        with contextlib.suppress(BlockingIOError):
            os.read(self._out, 4096)

    def close(self) -> None:
        """Close both ends of the pipe."""
        os.close(self._out)
        os.close(self._in)


def wait_readable(
    fds: Iterable[int], limit: float | None, writing: Collection[int] = ()
) -> set[int]:
    """Wait up to `limit` [s; None: for ever]; return what can be read or written."""
    # not select(): it refuses descriptors of 1024 and more
    poll = select.poll()
    for fd in fds:
        poll.register(fd, select.POLLIN | (select.POLLOUT if fd in writing else 0))
    # rounded up, or a thread would be awake for the last part of a millisecond
    wait = None if limit is None else int(limit * 1000) + 1
    return {fd for fd, _ in poll.poll(wait if limit else limit)}


def is_writable(fd: int) -> bool:
    """Return at once whether a send would find room."""
    poll = select.poll()
    poll.register(fd, select.POLLOUT)
    return any(event & select.POLLOUT for _, event in poll.poll(0))
