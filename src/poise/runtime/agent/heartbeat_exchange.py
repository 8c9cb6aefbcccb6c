"""An agent's heartbeats: to its manager and to other agents, whose clocks they tell.

A message leaves here at t0 and arrives there at t1; its answer leaves there at t2 and
arrives here at t3: the four time stamps of NTP. The offset of the other clock is
between t2 - t3 and t1 - t0, for any delays. Short round trips give tight bounds. Clocks
drift, so older bounds widen with age. The offset is in the intersection of all bounds
(Marzullo).
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from math import inf

from poise.clock import DRIFT, Clock
from poise.runtime.agent.fence import Fence, Lease
from poise.runtime.agent.surroundings import HeartbeatTransport
from poise.wire.control_session import endpoint_of
from poise.wire.heartbeats import (
    ASK_AFTER,
    ASK_EVERY,
    LEASE,
    UNCUT_LEASE,
    UNHEARD_AFTER,
    Address,
    Contacts,
    Hear,
    NextBeat,
    Received,
)
from poise.wire.records.heartbeat_records import (
    MANAGER,
    ClockStatus,
    Heartbeat,
    LinkQuality,
)
from poise.wire.records.request_records import Claim, majority_at

_KEPT = 64


class ClockOffset:
    """The offset of one other computer's clock, from the last round trips.

    Of each it keeps when it began, the bounds of the offset, and how long it took [s].
    Bounds widen with age: these are what they would have been at 0 of this clock.
    """

    def __init__(self) -> None:
        self._kept = tuple(deque[float](maxlen=_KEPT) for _ in range(4))
        self._sent, self._lows, self._highs, self._lasted = self._kept

    def add(
        self, sent: float, received: float, answered: float, returned: float
    ) -> None:
        """Add a round trip [s]; the two times between are the other clock's."""
        low, high = answered - returned, received - sent
        if low <= high and received <= answered:
            wide = DRIFT * sent
            self._sent.append(sent)
            self._lows.append(low + wide)
            self._highs.append(high - wide)
            self._lasted.append(high - low)

    def at(self, now: float) -> ClockStatus | None:
        """Return what is known at `now` [s, this clock]; None before any trip."""
        wide = DRIFT * now
        while self._sent:  # heartbeats that overtook each other contradict all
            low, high = max(self._lows) - wide, min(self._highs) + wide
            if low <= high:
                return ClockStatus(
                    offset=(low + high) / 2,
                    error=(high - low) / 2,
                    at=now,
                    trip=min(self._lasted),
                )
            self._forget_contradicted(wide)  # a clock was set
        return None

    def _forget_contradicted(self, wide: float) -> None:
        """Forget the newest bound that contradicts newer ones, and all before it."""
        low, high, trips = -inf, inf, [*zip(*self._kept, strict=True)]
        while low <= high:
            sent, low_then, high_then, _ = trips.pop()
            low, high = max(low, low_then - wide), min(high, high_then + wide)
        while self._sent and min(self._sent) <= sent:
            for values in self._kept:
                values.popleft()


_STALLED = 0.3
"""An agent that did not run for so long [s] asks before it judges who is silent."""
_GRACE = 0.15
_TO_LEAD = 2.0
"""A manager that claims an agent for the first time leads within this time [s]."""
_NAP = 0.05
"""A computer that was suspended for so long [s] has lost its lease."""
_CLOCKS_EVERY = 1.0
"""What is known of clocks is worked out this often [s]."""
_LATE = 0.05
"""A heartbeat may arrive this long after its sender has ended [s]."""
_AT_FIRST = 2.0
"""For so long it is with each heartbeat [s]: the quickest round trip counts."""


class HeartbeatExchange:
    """The heartbeats of one agent, from the moment when a manager claims it.

    `extend` is called with the moment when the lease ends [s, CLOCK_BOOTTIME], with
    each heartbeat and claim; infinite: there is no other computer, or no heartbeat.
    """

    def __init__(
        self,
        computer: str,
        contacts: Contacts,
        fence: Fence,
        clock: Clock,
        transport: Callable[[Hear, NextBeat], HeartbeatTransport | None],
        extend: Callable[[float], None],
        asleep: Callable[[], float],
    ) -> None:
        self.claim: Claim | None = None
        # what was known last of the clocks of other computers, by name
        self.clocks: Mapping[str, ClockStatus] = {}
        # those that were heard, and are not any more
        self.silent_computers: frozenset[str] = frozenset()
        self._computer = computer
        self._fence = fence
        self._clock = clock
        self._extend = extend
        self._asleep = asleep
        self._slept = asleep()
        self._contacts = contacts
        self._lease = Lease(self._contacts)
        self._offsets: dict[str, ClockOffset] = {}
        self._clocks_due = 0.0
        self._began: float | None = None
        self._targets: dict[str, Address] = {}
        self._claimed_at = clock.now()
        self._token_gone = inf
        self._lock = threading.Lock()
        self._looked_at = clock.now()
        self._grace_until = 0.0
        self._heartbeats = transport(self._hear, self._next_beat)

    def close(self) -> None:
        """Send no more."""
        if self._heartbeats is not None:
            self._heartbeats.close()

    def resume(self, claim: Claim | None) -> None:
        """Go on for an agent that was killed: what it kept may run elsewhere by now."""
        if claim is not None:
            # nobody has heard this one yet, and there is a lease's time for that
            self._grace_until = self._clock.now() + LEASE
            began = -inf if claim.is_leased else None
            self.obey(claim, began)

    def obey(self, claim: Claim, began: float | None = None) -> None:
        """Send heartbeats from now on to those whom a manager names that claims.

        The lease begins at once where datagrams are known to get through, for the
        manager may stand still before its first heartbeat; else with that. Where
        managers are voted for, it only goes on: a vote is no election.
        """
        others = {
            name: endpoint_of(where)
            for name, where in claim.agents.items()
            if name != self._computer
        }
        with self._lock:
            before, now = self._claimed_by, self._clock.now()
            self.claim, self._claimed_at = claim, now
            votes, is_first = self._votes, not before
            if began is None and votes:
                began = -inf if is_first else now - self._lease.age(now)
                if is_first:  # nothing is active that could be so twice
                    self._grace_until = now + _TO_LEAD
            elif began is None and self._lease.managed(now) is not None:
                began = now
            self._lease.begin(others.keys(), self._claimed_by, began, votes)
            if self._fence.is_cut_off:
                self._lease.end(now)
            if self._claimed_by != before:
                self._contacts.forget(MANAGER)
                self._targets.clear()
            self._targets |= {name: (e.host, e.port) for name, e in others.items()}
            self._extend(self._until(self._clock.now()) + self._slept)
        if self._heartbeats and self._began is None and (claim.is_leased or others):
            self._began = self._clock.now()
            self._heartbeats.send_to(self._targets)
            self._heartbeats.start()

    @property
    def _claimed_by(self) -> str:
        """The key of the manager that claimed it last."""
        return self.claim.manager.key if self.claim else ""

    @property
    def _votes(self) -> Mapping[str, int]:
        election = self.claim.election if self.claim else None
        return election.votes if election else {}

    @property
    def _is_leased(self) -> bool:
        return self.claim is not None and self.claim.is_leased

    @property
    def _is_alone(self) -> bool:
        """Whether no other computer of its robot has an agent."""
        return self.claim is None or self.claim.agents.keys() <= {self._computer}

    def leader_silent_from(self) -> float:
        """Return from when on its manager counts as silent, so far as is known [s]."""
        with self._lock:
            manager = self._contacts.get(MANAGER)
            heard_at = manager.heard_at if manager else self._claimed_at
            return max(heard_at + UNHEARD_AFTER, self._grace_until)

    def unanswering(self) -> list[str]:
        """Return who does not answer, if a majority of the votes lacks; else none."""
        with self._lock:
            now, answered = self._clock.now(), {self._computer: inf}
            for name in self._votes.keys() & self._targets.keys():
                contact = self._contacts.get(name)
                if contact is not None and contact.acked is not None:
                    answered[name] = contact.acked
            if majority_at(self._votes, answered) >= now - LEASE:
                return []
            return sorted(n for n in self._votes if answered.get(n, 0.0) < now - LEASE)

    def silent(self) -> dict[str, float]:
        """Return who was heard, and for how long it was not [s]."""
        with self._lock:
            now, names = self._clock.now(), (MANAGER, *self._targets)
            contacts = {name: self._contacts.get(name) for name in names}
            return {n: now - c.heard_at for n, c in contacts.items() if c is not None}

    def is_held(self) -> bool:
        """Return whether leased components may act now."""
        with self._lock:
            now = self._clock.now()
            return self._until(now) > now

    def note_told(self) -> None:
        """Note that a deployment came: a lease that had ended may begin again."""
        if self._fence.is_cut_off and self._votes:
            self._grace_until = self._clock.now() + LEASE
        self._fence.note_told()

    def note_lapsed(self) -> None:
        """Note that what is leased may run elsewhere: it waits for a deployment."""
        if not self._is_alone:
            self._fence.lapse()
            self._extend(-inf)

    def note_liveliness(self, key: str, *, is_there: bool) -> None:
        """Note that a manager's liveliness token came or went; from any thread.

        The token of one that is cut off goes, too, but a while after its last
        heartbeat: only one that was heard a moment before has ended, unless it is heard
        again. That one does not hear this agent, over a link that is cut one way. Nor
        does one that ended while this agent stood still for longer than its lease: what
        lay there meanwhile was not heard a moment before.
        """
        with self._lock:
            now, manager = self._clock.now(), self._contacts.get(MANAGER)
            silent = inf if manager is None else now - manager.heard_at
            unheard = self._lease.managed(now) or 0.0
            is_mine = key == self._claimed_by and self._is_leased
            if is_mine and not is_there:
                self._token_gone = now
        has_ended = not is_mine or (silent < UNHEARD_AFTER and unheard < LEASE)
        self._fence.note_liveliness(key, is_there=is_there, has_ended=has_ended)

    def links(self) -> Mapping[str, LinkQuality]:
        """Return how the ways to the other computers are, where that matters."""
        if not self._is_leased:  # nothing cuts them, and they may have to wait for CPU
            return {}
        with self._lock:
            return self._contacts.qualities(self._clock.now())

    def _hear(self, received: Sequence[Received]) -> bool:
        """Take in heartbeats; return whether to answer at once.

        The manager is always answered: one wake-up serves for both.
        """
        with self._lock:
            answers = [self._answers(*arrival) for arrival in received]
        return any(answers)

    def _answers(self, beat: Heartbeat, source: Address, now: float) -> bool:
        sender = beat.sender
        if sender == MANAGER:
            if beat.key != self._claimed_by:
                return False
            self._targets[MANAGER] = source
        elif sender not in self._targets:
            return False
        if not self._contacts.note(beat, now):
            return False
        if sender == MANAGER:
            if now > self._token_gone + _LATE:
                self._fence.note_alive(beat.key)
            return True  # one wake-up serves for both
        echo = beat.heard.get(self._computer)
        if echo is not None:
            if sender not in self._offsets:
                self._offsets[sender] = ClockOffset()
            received = beat.sent - echo.held
            self._offsets[sender].add(echo.sent, received, beat.sent, now)
        return self._computer in beat.asks

    def _next_beat(self) -> tuple[Heartbeat, float]:
        with self._lock:
            return self._beat_at(self._clock.now())

    def _beat_at(self, now: float) -> tuple[Heartbeat, float]:
        age = self._lease.age(now)
        self._judge(now, age)
        self._note_clocks(now)
        self._note_silent(now)
        is_managed = self._fence.is_managed()
        is_late = ASK_AFTER < age < 2 * ASK_AFTER
        beat = self._contacts.next_beat(
            now,
            managed=self._lease.managed(now) if is_managed else None,
            manager=self._claimed_by if is_managed or self._votes else "",
            is_cut_off=self._fence.is_cut_off,
            asks=(MANAGER,) if is_late else (),
            revoked=self._lease.revoked(),
        )
        return beat, ASK_EVERY if is_late else self._contacts.pause(now)

    def _note_clocks(self, now: float) -> None:
        is_first = self._began is not None and now < self._began + _AT_FIRST
        if now >= self._clocks_due or is_first:
            self._clocks_due = now + _CLOCKS_EVERY
            clocks = {
                name: offset.at(now) for name, offset in sorted(self._offsets.items())
            }
            self.clocks = {name: clock for name, clock in clocks.items() if clock}

    def _note_silent(self, now: float) -> None:
        """Note which computers are lost, so far as can be known from here."""
        if now < self._grace_until or not self._is_leased:
            return  # it may not have been heard itself, or wait for CPU as others do
        unheard = self._contacts.unheard(now)
        silent = frozenset(n for n in unheard if n != MANAGER and n in self._targets)
        if silent != self.silent_computers:
            self.silent_computers = silent
            self._fence.wake()

    def _judge(self, now: float, age: float) -> None:
        """Tell the containers when the lease ends, or that it has ended."""
        stalled, slept = now - self._looked_at, self._asleep()
        self._looked_at = now
        if stalled > _STALLED:  # it could hear nobody meanwhile
            self._grace_until = max(self._grace_until, now + _GRACE)
            if age >= LEASE:
                self._lease.note_stall(now)
        has_slept, self._slept = slept > self._slept + _NAP, max(slept, self._slept)
        if not self._fence.is_cut_off and (
            has_slept or self._has_ended(now, age, stalled)
        ):
            self._fence.cut()
            self._lease.end(now)
        self._extend(self._until(now, age) + self._slept)

    def _has_ended(self, now: float, age: float, stalled: float) -> bool:
        if not self._is_leased:
            return stalled > UNCUT_LEASE
        if self._is_revoked():
            return True
        return now >= self._grace_until and self._until(now, age) <= now

    def _is_revoked(self) -> bool:
        return self._lease.is_revoked(self._computer, self._fence.token)

    def _until(self, now: float, age: float | None = None) -> float:
        """Return when leased components must stop [s]: they look themselves.

        While there is no manager nothing is started elsewhere: then it is enough that
        the agent runs.
        """
        if self._heartbeats is None or self._is_alone:
            return inf
        if self._fence.is_cut_off:
            return -inf
        if not self._is_leased:
            return now + UNCUT_LEASE
        if self._is_revoked():
            return -inf  # also a heartbeat that says so may extend it
        if self._votes or self._fence.is_managed() or now < self._grace_until:
            return self._lease.until(now, age)
        return now + LEASE  # without a manager nothing starts elsewhere
