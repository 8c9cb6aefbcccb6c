"""The manager's connections to the robot's agents, and what it asks of them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Self

from msgspec.structs import replace

from poise.clock import Clock
from poise.errors import AlreadyManaged, RunError
from poise.manage.agent_connections.claims import Claims, has_ended, manager_id
from poise.manage.agent_connections.reachability import AgentHeartbeats
from poise.manage.agent_connections.reports import (
    LOOK_EVERY,
    AgentReports,
    CheckpointCopies,
    nothing,
    reading,
)
from poise.manage.agent_connections.requests import (
    ANSWER_LIMIT,
    LOSS_DELAY,
    SEND_LIMIT,
    AgentRequests,
    PendingAnswer,
    keep_limit,
    reason_of,
    why_not_kept,
)
from poise.priority import before_components
from poise.wire.control_session import (
    SESSION_TIMEOUT,
    UNCUT_SESSION_TIMEOUT,
    close_session,
    open_session,
)
from poise.wire.heartbeats import (
    SURELY_ENDED,
    UNCUT_SURELY_ENDED,
    Contacts,
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
    Answer,
    CheckpointCopy,
    Claim,
    Claimed,
    Election,
    ManagerId,
    Refused,
    Request,
)
from poise.wire.records.status_records import AgentSample, AgentStatus

if TYPE_CHECKING:
    from poise.wire.credentials import Credentials, RenewableKeys


_LATE = SESSION_TIMEOUT + 1.0
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


class Agents(AgentReports):
    """The agents of one robot. Use it as a context manager.

    `on_sample`: called with every sample, on zenoh's thread; must not block;
    `is_leased`: something can cut agents off from this manager, so leases end what they
    run; `datagrams`: what carries heartbeats; None: a UDP socket; `keys`: what the
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
        is_leased: bool = True,
        datagrams: Datagrams | None = None,
        election: Election | None = None,
        keys: Credentials | None = None,
        control: str = "",
    ) -> None:
        super().__init__(robot, endpoints, clock)
        self.election = election
        self.is_leased = is_leased
        self._claims = Claims(
            manager_id(control), endpoints, election, is_leased=is_leased
        )
        heard = endpoints if is_leased else {}
        self.heartbeats = AgentHeartbeats(
            Contacts(robot, MANAGER, self.manager.key),
            heard,
            clock,
            self.on_silent,
            SURELY_ENDED if is_leased else UNCUT_SURELY_ENDED,
            datagrams or UdpDatagrams(clock, keys=keys),
            votes=self._claims.votes,
        )
        self.own_keys = _renewable(keys)
        self.checkpoints = CheckpointCopies()
        with before_components():  # zenoh's threads do nothing but carry messages
            self._session = open_session(
                connect=tuple(endpoints.values()),
                timeout=SESSION_TIMEOUT if is_leased else UNCUT_SESSION_TIMEOUT,
                keys=keys,
            )
        prefix = f"poise/{robot}"
        self._requests = AgentRequests(
            self._session, prefix, self, clock, self._claims.tokens
        )
        try:
            self._declare(prefix, on_sample)
        except BaseException:
            self.close()  # this process would not end before the session's threads
            raise

    def _declare(
        self, prefix: str, on_sample: Callable[[AgentSample], object] | None
    ) -> None:
        """Let zenoh bring what agents send, and tell them of this manager."""
        self._declared = [
            *self.subscribe(self._session),
            self._session.declare_subscriber(
                f"{prefix}/checkpoint/*",
                reading(CheckpointCopy, self.checkpoints.note, self.on_refused),
            ),
        ]
        if on_sample is not None:
            take = reading(AgentSample, on_sample, self.on_refused)
            samples = self._session.declare_subscriber(f"{prefix}/samples/*", take)
            self._declared.append(samples)
        # last, because agents report at once to a manager that comes
        self._token = self._session.liveliness().declare_token(
            f"{prefix}/manager/{self.manager.key}"
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def manager(self) -> ManagerId:
        """Who this manager is."""
        return self._claims.manager

    def close(self) -> None:
        """Leave the agents as they are."""
        self.heartbeats.close()
        close_session(self._session)

    def store_status(self, status: AgentStatus) -> None:
        """Store what an agent reported.

        One that obeys another manager answers the heartbeats of that one only: for this
        one it would be out of reach for ever. If it did not vote for this manager, the
        end of its lease is known already, and does not change.
        """
        manager = status.manager
        if manager is not None and manager.key != self.manager.key:
            with self._changed:
                self._silent.pop(status.computer, None)
                if status.computer in self._claims.accepted:
                    self.heartbeats.forget(status.computer)
        super().store_status(status)

    def obey(self, computer: str) -> bool:
        """Return whether an agent is reached and obeys this manager."""
        with self._changed:
            status = self._statuses.get(computer)
            return (
                status is not None
                and computer not in self._lost
                and computer not in self._silent
                and self._claims.is_obeyed(status)
            )

    def successor(self) -> ManagerId | None:
        """Return the manager to which this one gives way; None: there is none."""
        with self._changed:
            away = self._lost.keys() | self._silent.keys()
            return self._claims.successor(
                [s for name, s in self._statuses.items() if name not in away]
            )

    def wait_at_work(self, limit: float, check: Callable[[], object] = nothing) -> bool:
        """Return whether components run; who is missing after `limit` [s] is lost.

        Where managers are voted for, a majority is waited for, and the others a moment.
        """
        everyone, votes = set(self._endpoints), self._claims.votes

        def is_there() -> bool:
            check()
            return self.reached() >= everyone

        def is_majority() -> bool:
            return is_there() or self._claims.has_majority(self.reached())

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
        """Let the agents of `computers` obey this manager, and no other.

        In the order of their names: of two managers that start at the same time, one
        gets the first agent, and the other none.
        """
        deployments = {}
        self._claims.begin_term(self.statuses().values())
        for computer in sorted(computers):
            answer = self._claim(computer, take_over=take_over)
            if self.is_leased:
                self.heartbeats.start()
            if take_over:  # also what is out of reach may be claimed then
                self._note_signs(self._endpoints.keys() - self.reached(), [answer])
            if answer.deployment is not None:
                deployments[computer] = answer.deployment
            self.wait_news(partial(self.obey, computer), ANSWER_LIMIT)
        return deployments

    def elect(self, *, take_over: bool = False) -> dict[str, Claimed]:
        """Become the leader by a majority of votes; return the answers of agents.

        They are only asked first: nothing changes while a majority obeys another one
        (AlreadyManaged), or does not accept this one (RunError).
        """
        self._claims.begin_term(self.statuses().values())
        votes = self._claims.votes
        until = self._clock.now() + _VOTE_LIMIT
        while True:
            asked = self.reached() & votes.keys()
            try:
                agreed = self._ask_votes(asked, is_poll=True, take_over=take_over)
                break
            except RunError:  # some agents hear for a moment longer who led
                if self._clock.now() >= until:
                    raise
            self._clock.sleep(LOOK_EVERY)
        answers = self._ask_votes(agreed, is_poll=False, take_over=take_over)
        for name, answer in answers.items():
            self._claims.accept(name, answer)
        self.heartbeats.start()
        away = votes.keys() - answers.keys()
        for name in away:
            self.heartbeats.forget(name)
        self._note_signs(away, answers.values())
        until = self._clock.now() + _VOTE_LIMIT
        while not self.heartbeats.leads():
            if self._clock.now() >= until:
                raise RunError(self._why_unconfirmed(answers))
            self._clock.sleep(_LOOK_AT_VOTES)
        self.wait_news(lambda: all(map(self.obey, answers)), ANSWER_LIMIT)
        return answers

    def _note_signs(self, away: Iterable[str], answers: Collection[Claimed]) -> None:
        """Note when others heard agents, or their manager, last: it extends leases."""
        for name in away:
            signs = (a.silent.get(n, 0.0) for a in answers for n in (name, MANAGER))
            self.heartbeats.note_ended(name, min(signs))

    def _why_unconfirmed(self, voters: Iterable[str]) -> str:
        silent = [name for name in sorted(voters) if not self.heartbeats.answers(name)]
        if not silent:
            return "a majority of agents voted, and does not confirm that"
        return (
            "a majority of agents voted, but does not answer heartbeats (UDP): "
            f"{', '.join(silent)} (does a firewall let them through, both ways?)"
        )

    def _ask_votes(
        self, computers: Iterable[str], *, is_poll: bool, take_over: bool
    ) -> dict[str, Claimed]:
        """Return the answers of agents that accept this manager; raises as `elect`."""
        claims: dict[str, Request] = {}
        for name in sorted(computers):
            claim = self._new_claim(name, take_over=take_over)
            claims[name] = replace(claim, is_poll=is_poll)
        answers = self.request_all(claims, _VOTE_LIMIT)
        accepted = {n: a for n, a in answers.items() if isinstance(a, Claimed)}
        if self._claims.has_majority(accepted):
            return accepted
        refused = {n: a for n, a in answers.items() if isinstance(a, Refused)}
        said = sorted({answer.reason for answer in refused.values()})
        silent = [name for name, answer in answers.items() if answer is None]
        said += [f"no answer: {', '.join(sorted(silent))}"] if silent else []
        away = sorted(self._claims.votes.keys() - self.reached())
        said += [f"not reached: {', '.join(away)}"] if away else []
        text = f"no majority of votes: {'; '.join(said)}"
        led = [n for n, answer in refused.items() if answer.obeys_another]
        is_led = self._claims.has_majority(led)
        raise AlreadyManaged(text) if is_led else RunError(text)

    def has_stored(self, generation: int) -> bool:
        """Return whether a majority has stored a commit; so it does without votes."""
        if self.election is None:
            return True
        return self._claims.has_majority(
            name
            for name, status in self.statuses().items()
            if self.obey(name) and status.generation >= generation
        )

    def why_not_leading(self) -> str:
        """Return why this manager has to end, as it does not lead; empty: it does."""
        if not self._claims.accepted or self.heartbeats.unconfirmed() < _UNCONFIRMED:
            return ""
        return f"no majority of agents has heard it for {_UNCONFIRMED:g} s"

    def _claim(self, computer: str, *, take_over: bool) -> Claimed:
        """Claim an agent; one that was cut off learns late that its manager ended."""
        if not self.wait_news(lambda: computer in self.statuses(), SEND_LIMIT):
            raise RunError(f"the agent of '{computer}' has not reported yet")
        status = self.statuses().get(computer)
        before = status.manager if status is not None else None
        has_gone = before is not None and has_ended(before)
        is_late = bool(self._claims.accepted) or has_gone
        until = self._clock.now() + (_LATE if is_late else 0.0)
        while True:
            claim = self._new_claim(computer, take_over=take_over)
            answer = self._requests.send(computer, claim)
            if isinstance(answer, Claimed):
                self._claims.accept(computer, answer)
                return answer
            if self._clock.now() >= until:
                break
            self._clock.sleep(LOOK_EVERY)
        if answer is None:
            why = self._requests.why_silent(computer, SEND_LIMIT, LOSS_DELAY)
        else:
            why = f"refused: {reason_of(answer)}"
        is_led = isinstance(answer, Refused) and answer.obeys_another
        error = AlreadyManaged if is_led else RunError
        raise error(f"the agent of '{computer}' {why}")

    def begin_claim(self, computer: str) -> PendingAnswer:
        """Ask an agent to obey this manager; do not wait for its answer."""
        return self._requests.begin(computer, self._new_claim(computer))

    def end_claim(self, computer: str, reply: PendingAnswer) -> None:
        """Take note that an agent accepted a claim."""
        self._claims.accept(computer, reply.answer, reply.token)
        if self.is_leased:
            self.heartbeats.start()

    def begin_deploy(self, computer: str, deployment: Deployment) -> PendingAnswer:
        """Tell an agent what should run; do not wait for its answer."""
        with self._changed:
            self._claims.note_told(computer, deployment.generation)
        return self._requests.begin(computer, deployment)

    def begin_keeping(self, computer: str, copy: CheckpointCopy) -> PendingAnswer:
        """As `keep_checkpoint`, but do not wait for the agent's answer."""
        return self._requests.begin(computer, copy, keep_limit(copy))

    def begin_steps(self, computer: str, steps: MigrationSteps) -> PendingAnswer:
        """Let a container take steps; do not wait for its answer."""
        return self._requests.begin(computer, steps)

    def _new_claim(self, computer: str, *, take_over: bool = False) -> Claim:
        status = self.statuses().get(computer)
        return self._claims.new(computer, status, take_over=take_over)

    def ends_soon(self, computer: str) -> bool:
        """Return whether the lease of a lost computer has ended, or does soon."""
        return self.is_leased or self.heartbeats.have_leases_ended({computer})

    def revoke(self, computers: Iterable[str]) -> bool:
        """Obtain that components of lost computers may be started elsewhere.

        Their agents are to be claimed again then. It fails, and changes nothing, while
        the lease of one may not have ended yet.
        """
        names = tuple(computers)
        tokens = {name: self._claims.tokens.get(name, 0) for name in names}
        if not self.heartbeats.revoke(tokens):
            return False
        self._claims.revoke(names)
        return True

    def request(self, computer: str, request: Request, limit: float) -> Answer | None:
        """Return an agent's answer; None: it gave none within `limit` [s]."""
        return self.request_all({computer: request}, limit)[computer]

    def request_all(
        self, requests: Mapping[str, Request], limit: float
    ) -> dict[str, Answer | None]:
        """Return the answers of agents by computer; None: none within `limit` [s]."""
        asked = {name: (name, request, limit) for name, request in requests.items()}
        return dict(self._requests.answers(asked))

    def keep_checkpoint(self, computer: str, copy: CheckpointCopy) -> str:
        """Let an agent keep a state for a component that is to start there."""
        return why_not_kept(copy, self.request(computer, copy, keep_limit(copy)))

    def send_steps(
        self,
        batches: Iterable[tuple[str, MigrationSteps]],
        check: Callable[[], object] = nothing,
    ) -> Iterator[StepsOutcome]:
        """Let containers take steps, all at once; yield each outcome as it is known.

        `check`: called now and then; may raise to end the waiting.
        """
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
        self.heartbeats.forget(computer)

    def _on_ended_agent(self, computer: str) -> None:
        self.heartbeats.note_ended(computer)


def _renewable(keys: Credentials | None) -> RenewableKeys | None:
    if keys is None:
        return None
    from poise.wire.credentials import RenewableKeys  # noqa: PLC0415, `ssl` is slow

    return RenewableKeys(keys.folder)
