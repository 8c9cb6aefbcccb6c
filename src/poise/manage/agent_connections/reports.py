"""What agents reported, and which of them are there.

zenoh's threads only store it, in bounded structures; the manager's own wait for it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from typing import TypeVar

import zenoh
from msgspec import structs

from poise.clock import Clock, wall_time
from poise.decoding import msgpack_decoder
from poise.errors import RunError
from poise.wire.codec import MALFORMED
from poise.wire.control_session import IDENTITIES, parse_identity
from poise.wire.records.request_records import CheckpointCopy
from poise.wire.records.status_records import AgentStatus

S = TypeVar("S")

LOOK_EVERY = 0.1
"""How often is checked what may end a wait [s]."""
MOST_REFUSED = 100
"""At most this many different sentences about refused records are kept."""


def nothing() -> None:
    """Raise nothing: the default of what is checked while one waits."""


class CheckpointCopies:
    """The last checkpoints of incarnations, as agents sent them, for any thread."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock  # [s]
        self._lock = threading.Lock()
        self._copies: dict[tuple[str, int], tuple[CheckpointCopy, float]] = {}

    def note(self, copy: CheckpointCopy) -> None:
        """Keep a copy; one without data says that the one before still holds."""
        now, key = self._clock(), (copy.component, copy.epoch)
        with self._lock:
            if copy.data is None:
                if key not in self._copies:
                    return
                copy = structs.replace(copy, data=self._copies[key][0].data)
            self._copies[key] = copy, now

    def get(self, component: str, epoch: int) -> CheckpointCopy | None:
        """Return the last state of an incarnation, with its age now, if it is known."""
        with self._lock:
            copy, at = self._copies.get((component, epoch), (None, 0.0))
        if copy is None:
            return None
        return structs.replace(copy, age=copy.age + self._clock() - at)

    def keep_only(self, epochs: Mapping[str, int]) -> None:
        """Forget those of all other incarnations of these components."""
        with self._lock:
            for name, epoch in list(self._copies):
                if epochs.get(name, epoch) != epoch:
                    del self._copies[name, epoch]


class AgentReports:
    """What the agents of one robot reported last. Any thread may ask."""

    def __init__(self, robot: str, endpoints: Mapping[str, str], clock: Clock) -> None:
        self._robot = robot
        self._endpoints = endpoints
        self._clock = clock
        self._identities: dict[str, tuple[str, str]] = {}
        self._changed = threading.Condition()
        self._version = 0
        self._statuses: dict[str, AgentStatus] = {}
        self._heard: dict[str, float] = {}
        self._alive: set[str] = set()
        self._lost: dict[str, float] = {}
        self._silent: dict[str, float] = {}
        self._seen = dict(self._statuses), {**self._silent, **self._lost}
        """What any thread may read without the lock: replaced, and never changed."""
        self._refused: list[str] = []
        self._num_taken = 0
        self.on_status: Callable[[AgentStatus], object] = lambda _: None

    def subscribe(self, session: zenoh.Session) -> list[object]:
        """Store from now on what agents report; return what must be kept for that."""
        prefix, liveliness = f"poise/{self._robot}", session.liveliness()
        return [
            session.declare_subscriber(
                f"{prefix}/status/*",
                reading(AgentStatus, self.store_status, self.on_refused),
            ),
            liveliness.declare_subscriber(
                f"{prefix}/alive/*", self.on_alive, history=True
            ),
            liveliness.declare_subscriber(IDENTITIES, self.on_identity, history=True),
        ]

    def statuses(self) -> Mapping[str, AgentStatus]:
        """Return what each agent reported last, by computer."""
        return self._seen[0]

    def ages(self) -> dict[str, float]:
        """Return how long ago each agent reported last [s], by computer."""
        now = self._clock.now()
        with self._changed:
            return {name: now - self._heard[name] for name in self._statuses}

    def out_of_reach(self) -> Mapping[str, float]:
        """Return since when [s since 1970] agents that were there are not reached."""
        return self._seen[1]

    def reached(self) -> set[str]:
        """Return the computers whose agents are there and have reported."""
        with self._changed:
            return (self._alive & self._statuses.keys()) - self._silent.keys()

    def wait_news(self, is_enough: Callable[[], bool], limit: float) -> bool:
        """Wait until `is_enough` is true, evaluated at all news; return whether it is.

        `is_enough` may raise to end the waiting; `limit` is in [s].
        """
        deadline = self._clock.now() + limit
        while True:
            with self._changed:
                version = self._version
            # without the lock, for which zenoh's threads would wait
            if is_enough():
                return True
            left = deadline - self._clock.now()
            with self._changed:
                if left <= 0 or not self._changed.wait_for(
                    lambda seen=version: self._version != seen,  # type: ignore[misc]
                    left,
                ):
                    return False

    def notify(self) -> None:
        """Let every `wait_news` evaluate again."""
        with self._changed:
            self._note_news()

    def wait_alive(
        self,
        computers: Iterable[str],
        limit: float,
        check: Callable[[], None] = nothing,
        why_silent: Callable[[Iterable[str]], Mapping[str, str]] = lambda _: {},
    ) -> None:
        """Wait until the agents of all `computers` are there and reported.

        `check`: called now and then; may raise to end the waiting; `why_silent`: says
        why the agents of computers refuse connections; empty: it is not known.
        """
        wanted, deadline = set(computers), self._clock.now() + limit
        while not self.wait_news(lambda: wanted <= self.reached(), LOOK_EVERY):
            check()
            missing = sorted(wanted - self.reached())
            if others := "; ".join(filter(None, map(self.other_agent, missing))):
                raise RunError(others)
            if self._clock.now() < deadline or not missing:
                continue
            reasons = why_silent(missing).items()
            said = [f"{computer}: {why}" for computer, why in reasons if why]
            raise RunError(
                f"no agent answered within {limit:g} s on: {', '.join(missing)}. Is "
                "`poise agent` running there, and can this computer reach it?"
                + "".join(f"\n{refusal}" for refusal in [*said, *self.pop_refused()])
            )

    def other_agent(self, computer: str) -> str:
        """Return whose agent is at a computer's address instead; empty: no other's."""
        locator = self._endpoints[computer]
        found = self._identities.get(locator, (self._robot, computer))
        if found == (self._robot, computer):
            return ""
        return (
            f"at {locator.removeprefix('tcp/')} there is the agent of computer "
            f"'{found[1]}' of robot '{found[0]}', not of computer '{computer}' "
            f"of robot '{self._robot}'"
        )

    def pop_refused(self) -> list[str]:
        """Return new reasons why records were refused, each once."""
        with self._changed:
            new = self._refused[self._num_taken :]
            self._num_taken = len(self._refused)
            return new

    def on_refused(self, sentence: str) -> None:
        """Store why a record was refused."""
        with self._changed:
            is_known = sentence in self._refused
            if not is_known and len(self._refused) < MOST_REFUSED:
                self._refused.append(sentence)
                self._note_news()

    def store_status(self, status: AgentStatus) -> None:
        """Store what an agent reported."""
        if status.computer not in self._endpoints:
            return
        self.on_status(status)
        with self._changed:
            self._statuses[status.computer] = status
            self._heard[status.computer] = self._clock.now()
            self._note_news()

    def on_identity(self, sample: zenoh.Sample) -> None:
        """Store which agent is at an address."""
        locator, robot, computer = parse_identity(str(sample.key_expr))
        with self._changed:
            if sample.kind == zenoh.SampleKind.PUT:
                self._identities[locator] = robot, computer
            elif self._identities.get(locator) == (robot, computer):
                del self._identities[locator]

    def _on_new_agent(self, computer: str) -> None:
        """Know nothing of the agent of a computer that is back."""

    def _on_ended_agent(self, computer: str) -> None:
        """Note that an agent is gone now, so far as is known."""

    def on_alive(self, sample: zenoh.Sample) -> None:
        """Store that an agent came or went."""
        computer = str(sample.key_expr).rpartition("/")[2]
        with self._changed:
            if sample.kind == zenoh.SampleKind.PUT:
                self._alive.add(computer)
                if self._lost.pop(computer, None) is not None:
                    # it may be another agent: what this one reports is to come
                    self._statuses.pop(computer, None)
                    self._silent.pop(computer, None)
                    self._on_new_agent(computer)
            elif computer in self._alive:
                self._alive.discard(computer)
                self._note_lost(computer)
            self._note_news()

    def on_silent(self, computers: Iterable[str]) -> None:
        """Store whose heartbeats do not come."""
        with self._changed:
            now = wall_time()
            self._silent = {c: self._silent.get(c, now) for c in computers}
            self._note_news()

    def go_on_without_missing(self) -> None:
        """Count agents that are not there as lost."""
        with self._changed:
            for computer in self._endpoints.keys() - self._alive:
                self._note_lost(computer)
            self._note_news()

    def _note_lost(self, computer: str) -> None:
        """Note that an agent is gone: since it was silent, if it was before."""
        since = self._silent.get(computer, wall_time())
        self._lost.setdefault(computer, since)
        self._on_ended_agent(computer)

    def _note_news(self) -> None:
        self._seen = dict(self._statuses), {**self._silent, **self._lost}
        self._version += 1
        self._changed.notify_all()


def reading(
    type_: type[S], take: Callable[[S], object], refuse: Callable[[str], object]
) -> Callable[..., None]:
    """Return what takes the records of a type from agents, and refuses others."""
    decode = msgpack_decoder(type_).decode

    def hear(sample: zenoh.Sample) -> None:
        try:
            record = decode(sample.payload.to_bytes())
        except MALFORMED as error:
            refuse(f"a record at {sample.key_expr} was refused: {error}")
        else:
            take(record)

    return hear
