"""Tells systemd that the agent is ready, that it works, and that it ends."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import MutableMapping
from math import inf

_NOTICES_PER_LIMIT = 4
"""Notices within the time after which systemd's watchdog restarts the agent."""


class ServiceNotice:
    """Tells systemd, or nobody when the agent is no service (`sd_notify(3)`)."""

    def __init__(self, environment: MutableMapping[str, str] = os.environ) -> None:
        # containers inherit the environment, and must not speak for the agent
        path = environment.pop("NOTIFY_SOCKET", "")
        limit = environment.pop("WATCHDOG_USEC", "")
        is_own = environment.pop("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self._address = "\0" + path[1:] if path.startswith("@") else path
        is_watched = bool(path and limit and is_own)
        self._every = 1e-6 * float(limit) / _NOTICES_PER_LIMIT if is_watched else inf
        self.due = inf
        """When `live` is to be called next [s, the caller's clock]."""

    def start(self, now: float) -> None:
        """Say that the agent works."""
        self._say("READY=1")
        self.due = now + self._every

    def live(self, now: float) -> None:
        """Say that the agent lives, if that is due."""
        if now >= self.due:
            self._say("WATCHDOG=1")
            self.due = now + self._every

    def end(self) -> None:
        """Say that the agent ends its containers, and then itself."""
        self._say("STOPPING=1")

    def _say(self, text: str) -> None:
        if not self._address:
            return
        with (
            contextlib.suppress(OSError),  # then systemd restarts the agent
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out,
        ):
            out.settimeout(0.1)
            out.sendto(text.encode(), self._address)
