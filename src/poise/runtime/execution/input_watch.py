"""Which inputs of a component have nobody left who publishes there. Pure."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from poise.runtime.component.ports import InputEvent

_SETTLES = 0.05
"""A move joins the new source before the old one leaves, within this time [s]."""
_FIRST = 1.0
"""An input of a component that has just been activated is joined in this time [s]."""


class InputWatch:
    """The inputs of one component for which it has `lost` or `found`."""

    def __init__(self, ports: Collection[str], now: float) -> None:
        self.ports = frozenset(ports)
        self._missing_from = dict.fromkeys(self.ports, now + _FIRST - _SETTLES)
        self._lost: set[str] = set()

    def note(
        self, joined: Mapping[str, bool], now: float
    ) -> list[tuple[InputEvent, str]]:
        """Take in which ports have a source; return what has happened to which."""
        news: list[tuple[InputEvent, str]] = []
        for port in sorted(self.ports):
            if joined.get(port, False):
                self._missing_from.pop(port, None)
                if port in self._lost:
                    self._lost.remove(port)
                    news.append(("found", port))
            elif port not in self._lost:
                since = self._missing_from.setdefault(port, now)
                if now - since >= _SETTLES:
                    self._lost.add(port)
                    news.append(("lost", port))
        return news

    def is_pending(self) -> bool:
        """Return whether a source is missing that may soon count as lost."""
        return not self._lost >= self._missing_from.keys()
