"""The manager's connections to the robot's agents, and what it asks of them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Self, TypeGuard

from msgspec import structs
from msgspec.structs import replace

from poise.clock import Clock
from poise.errors import RunError
from poise.manage.agent_connections.manager_identity import (
    gives_way_to,
    has_ended,
    manager_id,
)
from poise.manage.agent_connections.reachability import AgentHeartbeats
from poise.manage.agent_connections.reports import AgentReports, reading
from poise.manage.agent_connections.requests import (
    ANSWER_LIMIT,
    LOOK_EVERY,
    LOSS_DELAY,
    SEND_LIMIT,
    AgentRequests,
    Reply,
    nothing,
)
from poise.priority import ahead
from poise.wire.control_session import LEASE, close_session, endpoint_of, open_session
from poise.wire.heartbeats import (
    SURELY_ENDED,
    UNCUT_SURELY_ENDED,
    Datagrams,
    UdpDatagrams,
)
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.heartbeat_records import MANAGER
from poise.wire.records.migration_records import (
    MigrationSteps,
    StepsDone,
    StepsFailed,
    StepsOutcome,
)
from poise.wire.records.request_records import (
    Accepted,
    Answer,
    CheckpointCopy,
    Claim,
    Claimed,
    Election,
    ManagerId,
    Refused,
    Request,
    majority_at,
)
from poise.wire.records.status_records import AgentSample, AgentStatus

if TYPE_CHECKING:
    from poise.wire.credentials import Credentials


class CheckpointCopies:
    """The last checkpoint of each component, as its agent sent it. Any thread may ask.

    `clock`: returns the time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._copies: dict[str, tuple[CheckpointCopy, float]] = {}

    def note(self, copy: CheckpointCopy) -> None:
        """Keep a copy; one without data says that the one before still holds."""
        now = self._clock()
        with self._lock:
            before, _ = self._copies.get(copy.component, (copy, now))
            if before.epoch > copy.epoch:
                return
            if copy.data is None:
                if before.data is None or before.epoch != copy.epoch:
                    return
                copy = structs.replace(copy, data=before.data)
            self._copies[copy.component] = copy, now

    def get(self, component: str, epoch: int) -> CheckpointCopy | None:
        """Return the last state of an incarnation, with its age now, if it is known."""
        with self._lock:
            copy, at = self._copies.get(component, (None, 0.0))
        if copy is None or copy.epoch != epoch:
            return None
        return structs.replace(copy, age=copy.age + self._clock() - at)


_LATE = LEASE + 1.0
"""An agent that was cut off knows within this time that its manager ended [s]."""
MARGIN = 0.1
"""An agent's answer to migration steps may come this much after their limit [s]."""
_VOTE_LIMIT = 1.0
"""Agents vote within this time [s]."""
_LOOK_AT_VOTES = 0.01
_OTHERS = 0.1
"""When a majority of agents is there, the others have this time [s]."""
_UNCONFIRMED = 2.0
"""A manager that no majority has heard for so long ends [s]."""
_REVOKED = 2
"""A token that was revoked counts as one so much higher, which no agent has."""
_LEAST_BANDWIDTH = 1e6
"""A state that is sent takes no longer than with this [bytes/s]."""


class Agents(AgentReports):
    """The agents of one robot. Use it as a context manager.

    `on_sample`: called with every sample, on zenoh's thread; must not block; `lease`:
    an agent that is cut off is out of reach after this time [s]; one that ends, at
    once; `datagrams`: what carries heartbeats; None: a UDP socket; `keys`: what the
    agents know this manager by; None: their network is its own; `control`: the control
    socket of this manager.
    """

    def __init__(  # noqa: PLR0913, each is a choice of the caller
        self,
        robot: str,
        endpoints: Mapping[str, str],
        clock: Clock,
        on_sample: Callable[[AgentSample], object] | None = None,
        *,
        lease: float = LEASE,
        datagrams: Datagrams | None = None,
        election: Election | None = None,
        keys: Credentials | None = None,
        control: str = "",
    ) -> None:
        super().__init__(robot, endpoints, clock)
        self.manager = manager_id(control)
        self.election = election
        self._is_leased = lease <= LEASE
        heard = endpoints if self._is_leased else {}
        self._heartbeats = AgentHeartbeats(
            robot,
            self.manager.key,
            heard,
            clock,
            self.on_silent,
            SURELY_ENDED if self._is_leased else UNCUT_SURELY_ENDED,
            datagrams or _datagrams(heard, clock, keys),
            votes=election.votes if election is not None else {},
        )
        self._tokens: dict[str, int] = {}
        self._claimed: dict[str, int] = {}
        self._told: dict[str, int] = {}
        self.checkpoints = CheckpointCopies()
        with ahead():  # zenoh's threads do nothing but carry messages
            self._session = open_session(
                connect=tuple(endpoints.values()), lease=lease, keys=keys
            )
        prefix = f"poise/{robot}"
        self._requests = AgentRequests(self._session, prefix, self, clock, self._tokens)
        self._declared = [
            *self.subscribe(self._session),
            self._session.declare_subscriber(
                f"{prefix}/checkpoint/*",
                reading(CheckpointCopy, self.checkpoints.note, self.on_refused),
            ),
        ]
        if on_sample is not None:
            self._declared.append(
                self._session.declare_subscriber(
                    f"{prefix}/samples/*",
                    reading(AgentSample, on_sample, self.on_refused),
                )
            )
        # last, because agents report at once to a manager that comes
        self._token = self._session.liveliness().declare_token(
            f"{prefix}/manager/{self.manager.key}"
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the agents as they are."""
        self._heartbeats.close()
        close_session(self._session)

    def take_status(self, status: AgentStatus) -> None:
        """Store what an agent reported."""
        manager = status.manager
        if manager is not None and manager.key != self.manager.key:
            with self._changed:
                self._silent.pop(status.computer, None)
                if status.computer in self._claimed:
                    self._heartbeats.forget(status.computer)
        super().take_status(status)

    def obey(self, computer: str) -> bool:
        """Return whether an agent is reached and obeys this manager."""
        with self._changed:
            status = self._statuses.get(computer)
            token = self._tokens.get(computer)
            return (
                status is not None
                and computer not in self._lost
                and computer not in self._silent
                and status.token == token
                and self._claimed.get(computer) == token
            )

    def successor(self) -> ManagerId | None:
        """Return the manager to which this one gives way; None: there is none."""
        with self._changed:
            away = self._lost.keys() | self._silent.keys()
            reached = [s for name, s in self._statuses.items() if name not in away]
            if self.election is not None and self._claimed:
                # its agent takes none of this term any more, whoever leads
                voted = [s.manager for s in reached if s.manager is not None]
                later = [m for m in voted if self._is_overtaken_by(m)]
                if later:
                    return max(later, key=lambda manager: manager.rank)
            return gives_way_to(self.manager, self._claimed, self._told, reached)

    def _is_overtaken_by(self, other: ManagerId) -> bool:
        return other.key != self.manager.key and other.term >= self.manager.term

    def wait_alive(
        self,
        computers: Iterable[str],
        limit: float,
        check: Callable[[], None] = nothing,
        why_silent: Callable[[str], str] = lambda _: "",
    ) -> None:
        """Wait until the agents of all `computers` are there and reported."""
        wanted, deadline = set(computers), self._clock.now() + limit
        while not self.wait_news(lambda: wanted <= self.reached(), LOOK_EVERY):
            check()
            self.raise_on_other_agents(wanted - self.reached())
            if self._clock.now() < deadline:
                continue
            missing = sorted(wanted - self.reached())
            reasons = {c: why_silent(self._endpoints[c]) for c in missing}
            said = [f"{c}: {why}" for c, why in reasons.items() if why]
            raise RunError(
                f"no agent answered within {limit:g} s on: {', '.join(missing)}. Is "
                "`poise agent` running there, and can this computer reach it?"
                + "".join(f"\n{refusal}" for refusal in [*said, *self.take_refused()])
            )

    def wait_at_work(self, limit: float, check: Callable[[], object] = nothing) -> bool:
        """Return whether components run; computers that are missing are lost then.

        Where managers are voted for, a majority is waited for, and the others a moment.

        `limit`: all are there within this time, or missing [s].
        """
        everyone = set(self._endpoints)
        votes = self.election.votes if self.election is not None else {}

        def is_there() -> bool:
            check()
            return self.reached() >= everyone

        def is_majority() -> bool:
            there = dict.fromkeys(self.reached(), 0.0)
            return is_there() or majority_at(votes, there) == 0.0

        until = self._clock.now() + limit
        if votes and self.wait_news(is_majority, limit):
            until = min(until, self._clock.now() + _OTHERS)
        self.wait_news(is_there, max(0.0, until - self._clock.now()))
        statuses = self.statuses().values()
        if not any(s.containers or (votes and s.is_at_work) for s in statuses):
            return False
        self.go_on_without_missing()
        return True

    def claim(
        self, computers: Collection[str], *, take_over: bool = False
    ) -> dict[str, Deployment]:
        """Let the agents of `computers` obey this manager, and no other."""
        deployments = {}
        self._begin_term()
        for computer in sorted(computers):
            answer = self._claim(computer, take_over=take_over)
            if self._is_leased:
                self._heartbeats.start()
            if isinstance(answer, Claimed) and answer.deployment is not None:
                deployments[computer] = answer.deployment
            self.wait_news(
                lambda c=computer: self.obey(c),  # type: ignore[misc]
                ANSWER_LIMIT,
            )
        return deployments

    def elect(self, *, take_over: bool = False) -> dict[str, Claimed]:
        """Become the leader by a majority of votes; return the answers of agents.

        They are only asked first: nothing changes while a majority obeys another one.
        Raises RunError: not enough agents accept this manager.
        """
        self._begin_term()
        votes = self.election.votes if self.election is not None else {}

        def claimed(computers: Collection[str], *, is_poll: bool) -> dict[str, Claimed]:
            claims: dict[str, Request] = {
                name: replace(
                    self._new_claim(name, take_over=take_over), is_poll=is_poll
                )
                for name in sorted(computers)
            }
            answers = self.ask_all(claims, _VOTE_LIMIT)
            accepted = {n: a for n, a in answers.items() if isinstance(a, Claimed)}
            if majority_at(votes, dict.fromkeys(accepted, 0.0)) < 0.0:
                said = sorted({a.reason for a in answers.values() if is_refused(a)})
                away = sorted(votes.keys() - computers)
                said += [f"not reached: {', '.join(away)}"] if away else []
                raise RunError(f"no majority of votes: {'; '.join(said)}")
            return accepted

        agreed = self._poll(
            lambda: claimed(self.reached() & votes.keys(), is_poll=True)
        )
        answers = claimed(agreed.keys(), is_poll=False)
        for name in answers:
            self._claimed[name] = self._tokens[name]
        self._heartbeats.start()
        for name in votes.keys() - answers.keys():
            heard = [
                min(a.silent.get(n, 0.0) for n in (name, MANAGER))
                for a in answers.values()
            ]
            self._heartbeats.forget(name)
            self._heartbeats.note_ended(name, min(heard))
        until = self._clock.now() + _VOTE_LIMIT
        while not self._heartbeats.leads():
            if self._clock.now() >= until:
                raise RunError("a majority of agents voted, and does not confirm that")
            self._clock.sleep(_LOOK_AT_VOTES)
        self.wait_news(lambda: all(map(self.obey, answers)), ANSWER_LIMIT)
        return answers

    def _poll(self, poll: Callable[[], dict[str, Claimed]]) -> dict[str, Claimed]:
        """Ask until a majority agrees; some agents hear for a moment longer who led."""
        until = self._clock.now() + _VOTE_LIMIT
        while True:
            try:
                return poll()
            except RunError:
                if self._clock.now() >= until:
                    raise
            self._clock.sleep(LOOK_EVERY)

    def leads(self) -> bool:
        """Return whether a majority obeys this manager, where that matters."""
        return self._heartbeats.leads()

    def have_leases_ended(self, computers: Collection[str]) -> bool:
        """Return whether the leases of lost computers have surely ended."""
        return self._heartbeats.have_leases_ended(computers)

    def has_stored(self, generation: int) -> bool:
        """Return whether a majority has stored a commit; so it does without votes."""
        if self.election is None:
            return True
        stored = {
            name: 0.0
            for name, status in self.statuses().items()
            if self.obey(name) and status.generation >= generation
        }
        return majority_at(self.election.votes, stored) == 0.0

    def why_not_leading(self) -> str:
        """Return why this manager has to end, as it does not lead; empty: it does."""
        if not self._claimed or self._heartbeats.unconfirmed() < _UNCONFIRMED:
            return ""
        return f"no majority of agents has heard it for {_UNCONFIRMED:g} s"

    def _begin_term(self) -> None:
        """Take a term that is higher than those of all managers that agents obey."""
        if not self._claimed:
            seen = [
                status.manager for status in self.statuses().values() if status.manager
            ]
            last = max((manager.term for manager in seen), default=0)
            self.manager = replace(self.manager, term=last + 1)

    def _claim(self, computer: str, *, take_over: bool) -> Answer:
        """Claim an agent; one that was cut off learns late that its manager ended."""
        if not self.wait_news(lambda: computer in self.statuses(), SEND_LIMIT):
            raise RunError(f"the agent of '{computer}' has not reported yet")
        status = self.statuses().get(computer)
        before = status.manager if status is not None else None
        is_late = bool(self._claimed) or (before is not None and has_ended(before))
        until = self._clock.now() + (_LATE if is_late else 0.0)
        while True:
            claim = self._new_claim(computer, take_over=take_over)
            answers, refusals = self._requests.send({computer: claim})
            if not refusals:
                self._claimed[computer] = self._tokens[computer]
                return answers[computer]
            if self._clock.now() >= until:
                raise RunError(refusals[computer])
            self._clock.sleep(LOOK_EVERY)

    def begin_claim(self, computer: str) -> Reply:
        """Ask an agent to obey this manager; do not wait for its answer."""
        return self._requests.begin(computer, self._new_claim(computer))

    def end_claim(self, computer: str, reply: Reply) -> None:
        """Take note that an agent accepted a claim."""
        self._claimed[computer] = reply.token
        if self._is_leased:
            self._heartbeats.start()

    def begin_deploy(self, computer: str, deployment: Deployment) -> Reply:
        """Tell an agent what should run; do not wait for its answer."""
        with self._changed:
            last = self._told.get(computer, 0)
            self._told[computer] = max(last, deployment.generation)
        return self._requests.begin(computer, deployment)

    def _new_claim(self, computer: str, *, take_over: bool = False) -> Claim:
        """Return a claim with a token that its agent has not seen."""
        status = self.statuses().get(computer)
        known = status.token if status is not None else 0
        self._tokens[computer] = max(known, self._tokens.get(computer, 0)) + 1
        return Claim(
            self.manager, take_over, self._endpoints, self._is_leased, self.election
        )

    def heard_by(self, computer: str) -> str:
        """Return a computer that still hears one out of reach; empty when none does."""
        return self._heartbeats.heard_by(computer)

    def ends_soon(self, computer: str) -> bool:
        """Return whether the lease of a lost computer has ended, or does soon."""
        return self._is_leased or self._heartbeats.have_leases_ended({computer})

    def is_sure(self, computer: str) -> bool:
        """Return whether an agent was heard just now and its lease holds."""
        return self._heartbeats.is_sure(computer)

    def is_cut_off(self, computer: str) -> bool:
        """Return whether an agent says that its lease has ended."""
        return self._heartbeats.is_cut_off(computer)

    def revoke(self, computers: Iterable[str]) -> bool:
        """Obtain that components of lost computers may be started elsewhere."""
        tokens = {name: self._tokens.get(name, 0) for name in computers}
        if not self._heartbeats.revoke(tokens):
            return False
        self._tokens |= {name: token + _REVOKED for name, token in tokens.items()}
        return True

    def ask(self, computer: str, request: Request, limit: float) -> Answer | None:
        """Return an agent's answer; None: it gave none within `limit` [s]."""
        return self.ask_all({computer: request}, limit)[computer]

    def ask_all(
        self, requests: Mapping[str, Request], limit: float
    ) -> dict[str, Answer | None]:
        """Return the answers of agents by computer; None: none within `limit` [s]."""
        asked = {name: (name, request, limit) for name, request in requests.items()}
        return dict(self._requests.answers(asked))

    def keep_checkpoint(self, computer: str, copy: CheckpointCopy) -> str:
        """Let an agent keep a state for a component that is to start there."""
        limit = ANSWER_LIMIT + len(copy.data or b"") / _LEAST_BANDWIDTH
        answer = self.ask(computer, copy, limit)
        if isinstance(answer, Accepted):
            return ""
        why = answer.reason if isinstance(answer, Refused) else str(answer)
        return why if answer else f"no answer within {limit:.0f} s"

    def take_steps(
        self,
        batches: Iterable[tuple[str, MigrationSteps]],
        check: Callable[[], object] = nothing,
    ) -> Iterator[StepsOutcome]:
        """Let containers take steps, all at once; yield each outcome as it is known."""
        began = self._clock.now()
        asked = {
            steps.number: (computer, steps, steps.limit + MARGIN)
            for computer, steps in batches
        }
        for number, answer in self._requests.answers(asked, check):
            computer, steps, limit = asked[number]
            if isinstance(answer, StepsDone | StepsFailed):
                yield answer
                continue
            why = f"answered {answer}"
            if answer is None:
                # a component may be paused: the agent has had time enough
                left = max(0.0, began + limit - self._clock.now())
                why = self._requests.why_silent(computer, limit, min(LOSS_DELAY, left))
            yield StepsFailed(steps.number, f"the agent of '{computer}' {why}")

    def _on_new_agent(self, computer: str) -> None:
        self._heartbeats.forget(computer)

    def _on_ended_agent(self, computer: str) -> None:
        self._heartbeats.note_ended(computer)


def is_refused(answer: Answer | None) -> TypeGuard[Refused]:
    """Return whether an agent refused what it was asked."""
    return isinstance(answer, Refused)


def _datagrams(
    endpoints: Mapping[str, str], clock: Clock, keys: Credentials | None
) -> UdpDatagrams:
    is_ipv6 = any(":" in endpoint_of(text).host for text in endpoints.values())
    return UdpDatagrams(clock, is_ipv6=is_ipv6, keys=keys)
