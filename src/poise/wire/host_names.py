"""Looks hosts up by name, on a thread: a name server may not answer for seconds."""

from __future__ import annotations

import contextlib
import socket
import threading

from poise import threads
from poise.endpoint import Endpoint

_AGAIN, _SOON = 5.0, 1.0
"""Names are looked up again after this time, for their addresses may change, and those
that are not known yet after this one [s]."""
_JOIN_LIMIT = 0.1


class HostNames:
    """The IP addresses of hosts, for one thread that must not wait for them."""

    def __init__(self, family: socket.AddressFamily) -> None:
        self._family = family
        self._known: dict[str, str] = {}
        self._names: list[str] = []
        self._thread: threading.Thread | None = None
        self._has_news = threading.Event()
        self._is_closed = False

    def find(self, host: str) -> str | None:
        """Return a host's IP address at once; None: it is not known yet."""
        known = self._known.get(host)
        if known is None and Endpoint(host, 0).is_ip:
            known = self._known[host] = host
        elif known is None and host not in self._names:
            if self._thread is None:
                thread = threads.daemon(self._main, "host names", again=True)
                thread.start()
                self._thread = thread
            self._names.append(host)
            self._has_news.set()
        return known

    def close(self) -> None:
        """Look nothing up any more."""
        self._is_closed = True
        self._has_news.set()
        if self._thread is not None:
            self._thread.join(_JOIN_LIMIT)
            if self._thread.is_alive():
                threads.abandon(self._thread)

    def _main(self) -> None:
        while not self._is_closed:
            for host in tuple(self._names):
                # the last address holds while no name server answers
                with contextlib.suppress(OSError, UnicodeError):
                    self._look_up(host)
            is_known = self._known.keys() >= {*self._names}
            self._has_news.wait(_AGAIN if is_known else _SOON)
            self._has_news.clear()

    def _look_up(self, host: str) -> None:
        found = socket.getaddrinfo(host, None, self._family, socket.SOCK_DGRAM)
        addresses = [str(address[0]) for *_, address in found]
        if self._known.get(host) not in addresses:
            self._known[host] = addresses[0]
