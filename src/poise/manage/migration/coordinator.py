"""The manager's side of a migration: new incarnations replace old ones, or do not.

Until the commit any failure rolls back; after it no source resumes, and before it no
target does. Why nothing is lost, doubled or reordered: docs/design/moves.md.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from msgspec import structs

from poise.errors import RunError, TakenOver
from poise.manage.agent_connections.statuses import (
    calling_ports,
    cut_links,
    keeping_ports,
)
from poise.manage.deploy.desired import Incarnation
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.migration.migration_report import MigrationReport
from poise.manage.migration.migration_rounds import MigrationRounds, PlacedStep
from poise.manage.migration.pending_migration import PREPARE_LIMIT, STALL_LIMIT, Stall
from poise.manage.observe.deviations import explain
from poise.model.robot import Connector
from poise.priority import going_first
from poise.units import named
from poise.wire.address import LOST_AFTER
from poise.wire.records.migration_records import (
    MigrationPhases,
    MigrationSteps,
    StepsDone,
    StepsOutcome,
    StepTaken,
)

DOWNTIME_LIMIT = 1.4
"""The migration is committed within this time after the pause [s], or rolls back."""
RESUME_LIMIT = 0.4
"""Resuming takes no longer than this [s], so that the downtime is 2 s at most: these
two, and `MARGIN` for each answer that does not come."""
LINGER = 0.1
"""The sources stay for this time after the targets resumed [s], and redirect callers
that chose their route before."""
LONGEST_LINGER = LOST_AFTER
"""They stay this long [s] while a sender is cut off, or waits for an answer: after that
its connection is lost."""
REMOVE_LIMIT = 2.0
"""What is to be removed has ended after this time [s]; else the journal says so."""


class Migration:
    """Targets take the place of sources, or do not. Use it once."""

    def __init__(
        self,
        live: LiveRobot,
        report: MigrationReport,  # what it is about; where all was and is to be
        sources: Sequence[Incarnation],
        targets: Sequence[Incarnation],
    ) -> None:
        self._live = live
        self._report = report
        self._sources = sources
        self._targets = targets
        gone = {incarnation.component for incarnation in sources}
        self._others = {
            n: incarnation for n, incarnation in live.placed.items() if n not in gone
        }
        self._away = live.agents.out_of_reach().keys()
        self._dropped: dict[str, str] = {}
        self._migration_number = 0
        self._names = [source.component for source in sources]
        self._what = f"migration of {report.name}"
        self._phases = MigrationPhases("manager", self._what)
        self._taken: list[StepTaken] = []
        self._unanswered: list[PlacedStep] = []
        self._committed_generation = 0  # 0: it is not committed

    def run(self) -> MigrationReport:
        """Migrate, or roll back.

        Nothing that goes wrong on the way is raised, but `RunError` where another
        manager has the robot, or may have it, for no agent could be told of the commit:
        that one decides whether what is half done is finished.
        """
        downtime, reason = 0.0, ""
        self._phases.enter("prepare")
        try:
            rounds = self._rounds()
            self._prepare(rounds)
        except RunError as error:
            reason = str(error)
            self._phases.enter("roll back")
        else:
            with going_first():
                paused = time.monotonic()
                reason = self._switch(rounds, paused + DOWNTIME_LIMIT)
                downtime = time.monotonic() - paused
        phases = self._phases.seconds()
        if reason:
            reason = self._with_losses(reason)
            desired = self._live.desired.without_configured_ahead(self._targets)
            desired = desired.with_coming(())
            desired = desired.aiming("active", self._names)
            self._live.commit(desired, f"{self._what} is rolled back: {reason}")
        else:
            self._linger()
            self._live.reconcile()
        self._wait_ended(self._targets if reason else self._sources)
        self._raise_on_successor()
        if not reason and not self._is_known():
            raise RunError(
                f"the {self._what} is committed, but no agent could be told: another "
                "manager may undo it; `poise status` says where it runs"
            )
        return structs.replace(
            self._report,
            committed=not reason,
            reason=reason,
            downtime=downtime,
            phases=phases,
            steps=tuple(self._taken),
            dropped={} if reason else self._dropped,
        )

    def _is_known(self) -> bool:
        """Return whether agents of all targets, or all sources, know of the commit."""
        agents = self._live.agents
        statuses = agents.statuses()
        return any(
            all(
                agents.obey(end.computer)
                and statuses[end.computer].generation >= self._committed_generation
                for end in ends
            )
            for ends in (self._targets, self._sources)
        )

    def _raise_on_successor(self) -> None:
        if successor := self._live.agents.successor():
            raise RunError(
                f"{successor} took over the robot during the {self._what}: "
                "`poise status` says where it runs now"
            )

    def _rounds(self) -> MigrationRounds:
        """Return the steps; raise RunError when they could not all be taken."""
        self._raise_on_failed()
        live = self._live
        for source in self._sources:
            placed = live.placed.get(source.component)
            if placed is None or placed.epoch != source.epoch:
                now = f"runs on '{placed.computer}' now" if placed else "has ended"
                raise RunError(
                    f"component '{source.component}' was changed meanwhile: it {now}"
                )
        self._raise_on_cut_state()
        lossy = self._lossy_connectors()
        return MigrationRounds(
            live.layout,
            self._sources,
            self._targets,
            self._others,
            calling_ports(live.agents.statuses()),
            live.gateways(),
            lossy=lossy,
            away=self._away,
        )

    def _raise_on_cut_state(self) -> None:
        """Raise RunError when a state would have to cross a link that is cut."""
        cut = cut_links(self._live.agents.statuses())
        to = {target.component: target.computer for target in self._targets}
        for source in self._sources:
            name, here = source.component, source.computer
            between = sorted({here, to.get(name, here)})
            if frozenset(between) in cut:
                raise RunError(
                    f"link '{'-'.join(between)}' is cut: the state of component "
                    f"'{name}' cannot cross it"
                )

    def _lossy_connectors(self) -> dict[str, int]:
        """Return connectors that cannot be drained, and what their subscribers keep."""
        moving = {source.component: source for source in self._sources}
        lossy = {}
        for connector, why, keep in _not_drained(self._live, self._others | moving):
            if moving.keys().isdisjoint(end.component for end in connector.between):
                continue
            if keep is None:
                raise RunError(f"connector '{connector}' cannot be drained: {why}")
            lossy[str(connector)] = keep
            self._dropped[str(connector)] = why
        return lossy

    def _prepare(self, rounds: MigrationRounds) -> None:
        desired = self._live.desired.aiming("stay", self._names).with_coming(
            self._targets
        )
        self._live.commit(desired, f"prepare the {self._what}")
        # higher than that of any earlier migration, whatever the clock says
        self._migration_number = self._live.desired.generation
        stall = Stall(self._live)

        def trouble() -> bool:
            stall.check(self._live.missing(self._targets), self._targets)
            return self._raise_on_failed()

        self._live.wait(self._targets, PREPARE_LIMIT, trouble)
        # what an action ended may be at work yet, where it is out of reach
        begun = [t for t in self._targets if t.component not in self._live.placed]
        self._live.end_left_behind(begun)
        limit = PREPARE_LIMIT if self._copies_ahead() else STALL_LIMIT
        self._send_round(rounds.prepare(), limit, self._raise_on_failed)

    def _copies_ahead(self) -> bool:
        """Return whether a large state, or the import of `adapt`, may take its time."""
        found = map(self._live.reported, self._targets)
        return any(t.adapt for t in self._targets) or any(
            component.copies_ahead for component in found if component is not None
        )

    def _switch(self, rounds: MigrationRounds, deadline: float) -> str:
        """Pause, and let the targets go on, or the sources again; return why those."""
        self._phases.enter("quiesce")
        try:
            for steps in rounds.pause_and_transfer():
                began = time.monotonic()
                answers = self._send_round(steps, _left(deadline))
                quiesced = began + _quiescing(answers)
        except RunError as error:
            self._phases.enter("roll back")
            self._send_last_round(rounds.roll_back())
            return str(error)
        self._phases.enter("transfer", quiesced)
        self._phases.enter("commit")
        # nothing rolls back any more; sources redirect until agents are told
        desired = self._live.desired.without(self._names)
        desired = desired.placing(
            incarnation.with_goal("active") for incarnation in self._targets
        )
        self._live.commit(desired, f"{self._what} is committed", tell_later=True)
        self._committed_generation = self._live.desired.generation
        self._phases.enter("resume")
        self._send_last_round(rounds.resume())
        return ""

    def _linger(self) -> None:
        """Let the sources redirect callers until all senders have left them."""
        deadline = time.monotonic() + LONGEST_LINGER
        time.sleep(LINGER)
        unanswered = self._unanswered
        while unanswered and time.monotonic() < deadline:
            with contextlib.suppress(TakenOver):  # that is seen later
                self._live.check()
            unanswered = self._tell_all(unanswered)
            time.sleep(LINGER)
        if unanswered:
            names = sorted(f"'{sender.component}'" for sender, _ in unanswered)
            self._note_failure(
                f"{', '.join(names)} may still send to the earlier place"
            )

    def _send_round(
        self,
        steps: Sequence[PlacedStep],
        limit: float,
        check: Callable[[], object] = lambda: None,
    ) -> list[StepsDone]:
        """Let containers take steps, until `check` raises; return their answers."""
        answers = []
        for _, outcome in self._outcomes(steps, limit, check):
            if not isinstance(outcome, StepsDone):
                raise RunError(outcome.reason)
            answers.append(outcome)
        return answers

    def _send_last_round(self, steps: Sequence[PlacedStep]) -> None:
        """Let the targets, or the sources again, go to work.

        A container that is not reached follows the next deployment: it then has one
        route only, and sends there what it buffered.
        """
        failed = self._tell_all(steps, self._note_failure)
        self._unanswered = [
            step for step in failed if step[1].name == "release to targets"
        ]

    def _tell_all(
        self,
        steps: Sequence[PlacedStep],
        on_failure: Callable[[str], object] = lambda _: None,
    ) -> list[PlacedStep]:
        """Let all containers take their steps; return those that may not be taken."""
        failed: list[PlacedStep] = []
        for batch, outcome in self._outcomes(steps, RESUME_LIMIT, lambda: None):
            if not isinstance(outcome, StepsDone):
                on_failure(outcome.reason)
                failed += batch[len(outcome.taken) :]
        return failed

    def _outcomes(
        self, steps: Sequence[PlacedStep], limit: float, check: Callable[[], object]
    ) -> Iterator[tuple[list[PlacedStep], StepsOutcome]]:
        """Send each container its steps; yield these and the outcome as it is known."""
        batches: dict[tuple[str, str], list[PlacedStep]] = {}
        for placed in steps:
            batches.setdefault(self._live.layout.container_at(placed[0]), []).append(
                placed
            )
        by_number = {next(self._live.batch_numbers): key for key in batches}
        told = [
            (
                computer,
                MigrationSteps(
                    number=number,
                    migration=self._migration_number,
                    container=container,
                    steps=tuple(step for _, step in batches[computer, container]),
                    limit=limit,
                    targets=tuple(each.key for each in self._targets),
                ),
            )
            for number, (computer, container) in by_number.items()
        ]
        for outcome in self._live.agents.send_steps(told, check):
            self._taken += outcome.taken
            yield batches[by_number[outcome.number]], outcome

    def _wait_ended(self, gone: Sequence[Incarnation]) -> None:
        """Wait until what is not desired any more has ended; say what does not end."""
        live = self._live

        def have_ended() -> bool:
            live.check()
            live.reconcile()
            away = live.agents.out_of_reach().keys()
            is_told = not self._committed_generation or self._is_known()
            is_told = is_told or away >= {target.computer for target in self._targets}
            return is_told and all(map(live.has_ended, gone))

        live.agents.wait_news(have_ended, REMOVE_LIMIT)
        if hanging := [e.component for e in gone if not live.has_ended(e)]:
            self._note_failure(
                f"{named('component', hanging)} did not stop within {REMOVE_LIMIT:g} s"
            )

    def _with_losses(self, reason: str) -> str:
        """Return why it rolled back; a loss is known later than what it leads to."""
        losses = self._live.unreached().items()
        new = [text for computer, text in losses if computer not in self._away]
        return "; ".join([reason, *(text for text in new if text not in reason)])

    def _note_failure(self, reason: str) -> None:
        self._live.journal.note("failed", f"{self._what}: {reason}")

    def _raise_on_failed(self) -> bool:
        live = self._live
        live.poll()
        live.raise_on_broken([*self._sources, *self._targets])
        for source in self._sources:
            found = live.reported(source)
            if found is not None and found.state != "active":
                what = explain(source, found, live.health_of(source))
                raise RunError(f"{what}: its state cannot be transferred")
        return False


def _quiescing(answers: Iterable[StepsDone]) -> float:
    """Return how long the slowest container of a round quiesced [s]."""
    quiescing = (
        sum(t.ended - t.began for t in answer.taken if t.phase == "quiesce")
        for answer in answers
    )
    return max(quiescing, default=0.0)


def _left(deadline: float) -> float:
    left = deadline - time.monotonic()
    if left <= 0:
        raise RunError(f"the downtime reached {DOWNTIME_LIMIT:g} s")
    return left


def stuck_components(live: LiveRobot) -> set[str]:
    """Return the ends of connectors that would lose messages if an end moved now."""
    return {
        end.component
        for connector, _, keep in _not_drained(live, live.placed)
        if keep is None
        for end in connector.between
    }


def _not_drained(
    live: LiveRobot, placed: Mapping[str, Incarnation]
) -> Iterator[tuple[Connector, str, int | None]]:
    """Yield the connectors that cannot be drained now, and why.

    And how many messages the subscriber keeps; None: none may be lost, or an end hangs.
    """
    unreached = live.unreached_connectors(placed)
    keeps = keeping_ports(live.agents.statuses())
    for connector in live.layout.connectors(placed):
        if (why := unreached.get(str(connector))) is None:
            continue
        subscriber = connector.between[1]
        keep = keeps.get((subscriber.component, subscriber.port))
        if keep is None:
            why += f"; '{subscriber}' has no `keep`, so nothing may be lost"
        elif live.unresponsive(placed[end.component] for end in connector.between):
            keep = None
        yield connector, why, keep
