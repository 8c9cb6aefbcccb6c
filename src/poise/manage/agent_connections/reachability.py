"""The manager's heartbeats: which agents are reached, and whose leases have ended.

Only time in which the manager itself ran counts as silence: while it was stalled, or
the whole machine was, nobody could be heard.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Mapping, Sequence
from math import inf
from typing import NamedTuple

from poise.clock import Clock, time_asleep
from poise.wire.control_session import endpoint_of
from poise.wire.heartbeats import (
    ASK_AFTER,
    ASK_EVERY,
    EVERY,
    LEASE,
    UNHEARD_AFTER,
    Contacts,
    Datagrams,
    Heartbeats,
    Received,
)
from poise.wire.records.heartbeat_records import MANAGER, Heartbeat
from poise.wire.records.request_records import majority_at

_STALLED = 1.5 * EVERY
"""Between two looks no more than this counts [s]."""
_NAP = 0.05
"""A computer that was suspended for so long [s] confirms nothing from before."""
_LATER = 0.15
"""Another agent hears one that the manager does not when its last sign came so much
later [s]: of one that is gone, last signs come within a heartbeat of each other."""
_INFORMED = 0.3
"""An agent's heartbeat says of the manager's up to so long ago that it came [s]."""


class _Silence:
    """For how long no sign came, of the time that counts."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self.last = float("-inf")

    def measure(self, sign: float, now: float, counted: float) -> None:
        """Take in when the last sign came, so far as is known now.

        That another agent heard is known to a few milliseconds, which differ each time:
        a sign that came little later leaves most of the silence as it was.
        """
        if sign > self.last:
            self.seconds = max(0.0, self.seconds - (sign - self.last))
            self.last = sign
        self.seconds = min(self.seconds + counted, max(0.0, now - sign))


class _Agent(NamedTuple):
    direct: _Silence
    any: _Silence


class AgentHeartbeats:
    """Exchanges heartbeats with agents, and says which it hears; any thread may ask.

    An agent of which no heartbeat answered one of the manager is not judged: datagrams
    may not get through. What it runs stops some time after it has ended.

    `surely_ended`: the lease of an agent that is silent, or has ended, has ended, too,
    after this time [s]; `datagrams`: what carries heartbeats.
    """

    def __init__(
        self,
        contacts: Contacts,
        endpoints: Mapping[str, str],
        clock: Clock,
        on_silent: Callable[[list[str]], object],
        surely_ended: float,
        datagrams: Datagrams,
        *,
        votes: Mapping[str, int] = {},
    ) -> None:
        self._contacts = contacts
        self._clock = clock
        self._on_silent = on_silent
        self._surely_ended = surely_ended
        self._votes = votes
        self._silent: set[str] = set()
        self._revoked: dict[str, int] = {}
        self._lock = threading.RLock()
        self._slept = time_asleep()
        self._woke_at = -inf
        self._unconfirmed = 0.0
        self._ended_at: dict[str, float] = {}
        self._agents: dict[str, _Agent] = {}
        self._looked_at: float | None = None
        where = {name: endpoint_of(text) for name, text in endpoints.items()}
        self._computers = tuple(where)
        self._heartbeats = Heartbeats(clock, self._hear, self.next_beat, datagrams)
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
        """Know nothing of an agent, until it is heard again: it may be another one."""
        with self._lock:
            self._contacts.forget(computer)
            self._agents.pop(computer, None)
            self._ended_at.pop(computer, None)
            self._silent.discard(computer)

    def note_ended(self, computer: str, ago: float = 0.0) -> None:
        """Note that an agent is gone for this time [s], or less, or is missing."""
        with self._lock:
            ended_at = self._ended_at.get(computer, -inf)
            self._ended_at[computer] = max(self._clock.now() - ago, ended_at)

    def leads(self) -> bool:
        """Return whether a majority obeyed this manager a moment before."""
        with self._lock:
            now = self._clock.now()
            return now - self._confirmed_at(now) < LEASE

    def unconfirmed(self) -> float:
        """Return for how long it has not led, of the time that counts [s]."""
        with self._lock:
            return self._unconfirmed

    def answers(self, computer: str) -> bool:
        """Return whether an agent has answered any heartbeat."""
        with self._lock:
            contact = self._contacts.get(computer)
            return contact is not None and contact.acked is not None

    def is_heard(self, computer: str) -> bool:
        """Return whether an agent still exchanges heartbeats that seemed to be gone.

        So only its connection is cut, and its lease lasts.
        """
        with self._lock:
            agent, contact = self._agents.get(computer), self._contacts.get(computer)
            ended_at = self._ended_at.get(computer)
            if agent is None or contact is None or ended_at is None:
                return False
            is_later = agent.direct.last - ended_at > _LATER
            is_silent = agent.direct.seconds >= UNHEARD_AFTER
            return is_later and not is_silent and not contact.last.is_cut_off

    def heard_by(self, computer: str) -> str:
        """Return another agent that hears this one; empty when none does."""
        with self._lock:
            now = self._clock.now()
            agent = self._agents.get(computer)
            relayed = self._contacts.relayed(computer, now)
            if relayed is None:
                return ""
            other, at = relayed
            if agent is None:  # it is not judged
                last, silent = self._ended_at.get(computer, now), now - at
            else:
                last, silent = agent.direct.last, agent.any.seconds
            return other if silent < UNHEARD_AFTER and at - last > _LATER else ""

    def is_sure(self, computer: str) -> bool:
        """Return whether an agent was heard just now and its lease holds."""
        with self._lock:
            return computer not in self._doubted() and not self.is_cut_off(computer)

    def is_cut_off(self, computer: str) -> bool:
        """Return whether an agent said last that its lease has ended."""
        with self._lock:
            contact = self._contacts.get(computer)
            return contact is not None and contact.last.is_cut_off

    def have_leases_ended(self, computers: Collection[str]) -> bool:
        """Return whether the leases of lost computers have surely ended."""
        with self._lock:
            now = self._clock.now()
            # what other agents hear of it later is not known
            known_until = self._confirmed_at(now)
            if known_until <= now - LEASE:
                return False
            return all(
                self._agents[name].any.seconds - (now - known_until)
                >= self._surely_ended
                if name in self._agents
                else now - self._last_sign(name, now) >= self._surely_ended
                for name in computers
            )

    def revoke(self, tokens: Mapping[str, int]) -> bool:
        """Revoke fencing tokens of computers whose leases have surely ended."""
        with self._lock:
            have_ended = self.have_leases_ended(tokens.keys())
            if have_ended:
                self._revoked |= tokens
            return have_ended

    def next_beat(self) -> tuple[Heartbeat, float]:
        """Judge agents by what came; return what to send, and the pause then [s]."""
        now = self._clock.now()
        with self._lock:
            self._measure(now)
            silent = {
                name
                for name, agent in self._agents.items()
                if agent.direct.seconds >= UNHEARD_AFTER
            }
            has_changed, self._silent = silent != self._silent, silent
            ago, asks = now - self._confirmed_at(now), self._doubted()
            beat = self._contacts.next_beat(
                now,
                managed=ago if ago < inf else None,
                asks=asks,
                revoked=dict(self._revoked),
            )
        if has_changed:
            self._on_silent(sorted(silent))
        return beat, ASK_EVERY if asks else EVERY

    def _hear(self, received: Sequence[Received]) -> bool:
        with self._lock:
            news = [b for b, _, at in received if self._contacts.note(b, at)]
        return any(MANAGER in beat.asks for beat in news)

    def _confirmed_at(self, now: float) -> float:
        """Return when this manager led for sure, at the latest [s]; else -inf.

        Agents with a majority of the votes have heard what it sent then, and obey it.
        """
        if not self._votes:
            return now
        acked = {
            name: contact.acked
            for name in self._votes
            if (contact := self._contacts.get(name)) is not None
            and contact.acked is not None
            and contact.acked >= self._woke_at
            and contact.last.manager == self._contacts.key
        }
        return majority_at(self._votes, acked)

    def _measure(self, now: float) -> None:
        last = now if self._looked_at is None else self._looked_at
        counted, self._looked_at = min(now - last, _STALLED), now
        slept = time_asleep()
        if slept > self._slept + _NAP:  # another may lead since, and no clock ran
            self._slept, self._woke_at = slept, now
        leads = now - self._confirmed_at(now) < LEASE
        self._unconfirmed = 0.0 if leads else self._unconfirmed + counted
        for name in self._computers:
            contact = self._contacts.get(name)
            if contact is None or contact.acked is None:
                continue
            # its lease was extended at this moment at the latest, on any clock
            unanswered = self._contacts.unanswered_since(name)
            sign = min(contact.heard_at, unanswered + _INFORMED)
            # of one that is heard itself, it matters little when others heard it
            is_quiet = now - sign > _STALLED
            relayed = self._contacts.relayed(name, now) if is_quiet else None
            known = self._agents.get(name)
            if known is None:
                known = self._agents[name] = _Agent(_Silence(), _Silence())
            known.direct.measure(sign, now, counted)
            known.any.measure(max(sign, relayed[1]) if relayed else sign, now, counted)

    def _doubted(self) -> list[str]:
        """Return whom to ask for a sign of life."""
        return [
            name
            for name, agent in self._agents.items()
            if ASK_AFTER <= agent.direct.seconds < UNHEARD_AFTER
        ]

    def _last_sign(self, computer: str, now: float) -> float:
        """Return when an agent that is not judged ended, or others heard it [s]."""
        relayed = self._contacts.relayed(computer, now)
        ended_at = self._ended_at.get(computer, now)
        return max(ended_at, relayed[1]) if relayed else ended_at
