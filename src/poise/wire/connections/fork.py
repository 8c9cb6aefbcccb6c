"""Keeps connections out of processes that a component forks.

A forked process shares all open sockets, so the other end of a connection would not
notice that the container has ended. ``SOCK_CLOEXEC`` closes them only at an exec.
"""

from __future__ import annotations

import os
import socket
from weakref import WeakSet

_private: WeakSet[socket.socket] = WeakSet()


def keep_private(connection: socket.socket) -> None:
    """Let no forked process share a socket."""
    _private.add(connection)


def _let_go() -> None:
    try:
        unconnected = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    except OSError:  # no descriptor is free
        for each in _private:
            each.close()
        return
    with unconnected:
        # their numbers stay in use: whatever still sends there gets an error
        for each in _private:
            if each.fileno() >= 0:
                os.dup2(unconnected.fileno(), each.fileno())


os.register_at_fork(after_in_child=_let_go)
