"""The manager's heartbeats: which agents are reached, and whose leases have ended."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Mapping

from poise.clock import Clock
from poise.manage.agent_connections.reachability import Reachability
from poise.wire.control_session import endpoint_of
from poise.wire.failure_detector import ASK_EVERY, EVERY, Contacts
from poise.wire.heartbeats import Address, Heartbeats
from poise.wire.records.heartbeats import MANAGER, Heartbeat


class AgentHeartbeats:
    """Exchanges heartbeats with agents; any thread may ask.

    Parameters
    ----------
    key
        Of this start of the manager.
    endpoints
        Computer -> zenoh endpoint of its agent.
    on_silent
        Called on the thread of the heartbeats, when that has changed, with the
        computers that do not hear the manager, or are not heard.
    surely_ended
        The lease of an agent that ended has ended, too, after this time [s].
    """

    def __init__(
        self,
        robot: str,
        key: str,
        endpoints: Mapping[str, str],
        clock: Clock,
        on_silent: Callable[[set[str]], object],
        surely_ended: float,
    ) -> None:
        self._clock = clock
        self._on_silent = on_silent
        self._silent: set[str] = set()
        self._revoked: dict[str, int] = {}
        self._lock = threading.Lock()
        self._contacts = Contacts(robot, MANAGER, key)
        self._reachability = Reachability(self._contacts, surely_ended)
        where = {name: endpoint_of(each) for name, each in endpoints.items()}
        self._computers = tuple(where)
        self._heartbeats = Heartbeats(
            clock,
            self._hear,
            self._next_beat,
            is_ipv6=any(":" in each.host for each in where.values()),
        )
        self._heartbeats.send_to({n: (e.host, e.port) for n, e in where.items()})
        self._has_begun = False

    def start(self) -> None:
        """Begin; harmless when repeated."""
        if not self._has_begun:
            self._has_begun = True
            self._heartbeats.start()

    def close(self) -> None:
        """End."""
        self._heartbeats.close()

    def forget(self, computer: str) -> None:
        """Take the agent of a computer for a new one, until it is heard."""
        with self._lock:
            self._reachability.forget(computer)
            self._silent.discard(computer)

    def note_ended(self, computer: str) -> None:
        """Note that an agent has ended now, or is found missing."""
        with self._lock:
            self._reachability.note_ended(computer, self._clock.now())

    def have_leases_ended(self, computers: Collection[str]) -> bool:
        """Return whether the leases of lost computers have surely ended."""
        with self._lock:
            now = self._clock.now()
            return self._reachability.have_leases_ended(computers, now)

    def heard_by(self, computer: str) -> str:
        """Return another agent that hears this one; empty when none does."""
        with self._lock:
            return self._reachability.heard_by(computer, self._clock.now())

    def is_cut_off(self, computer: str) -> bool:
        """Return whether an agent said last that its lease has ended."""
        with self._lock:
            contact = self._contacts.get(computer)
            return contact is not None and contact.last.is_cut_off

    def revoke(self, tokens: Mapping[str, int]) -> bool:
        """Revoke fencing tokens of computers whose leases have surely ended.

        Returns
        -------
        Whether all have; else nothing is revoked.
        """
        with self._lock:
            now = self._clock.now()
            have_ended = self._reachability.have_leases_ended(tokens.keys(), now)
            if have_ended:
                self._revoked |= tokens
            return have_ended

    def _hear(self, beat: Heartbeat, _: Address, now: float) -> bool:
        with self._lock:
            is_news = self._contacts.note(beat, now)
        return is_news and MANAGER in beat.asks

    def _next_beat(self) -> tuple[Heartbeat, float]:
        now = self._clock.now()
        with self._lock:
            self._reachability.look(self._computers, now)
            silent, asks = self._reachability.silent(), self._reachability.asks()
            has_changed, self._silent = silent != self._silent, silent
            beat = self._contacts.next_beat(now, asks=asks, revoked=dict(self._revoked))
        if has_changed:
            self._on_silent(set(silent))
        return beat, ASK_EVERY if asks else EVERY
