"""Takes the steps of a transition, and rolls them back when one fails."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence

from msgspec import structs

from poise.clock import wall_time
from poise.errors import RunError, UsageError
from poise.manage.agent_connections.statuses import located
from poise.manage.deploy.desired import Incarnation
from poise.manage.deploy.running_components import (
    ACTIVE_LIMIT,
    READY_LIMIT,
    RunningComponents,
)
from poise.manage.migration.migration_report import (
    MigrationReport,
    TransitionReport,
    TransitionStep,
)
from poise.manage.migration.move import plan_move
from poise.manage.observe.deviations import Deviation
from poise.units import counted
from poise.wire.heartbeats import LEASES_END_WITHIN

_LOOK_EVERY = 0.02


def start_together(
    run: RunningComponents,
    placement: Mapping[str, str],
    lost: Collection[str] = (),
    instead: Mapping[str, Incarnation] = {},
) -> bool:
    """Start components from their checkpoints; return whether they work.

    `instead`: component -> what it is like from now on; else it is as it was.

    Without a checkpoint they start without state. What is left of them where they ran
    is ended before; on a computer that is out of reach, once that is back.
    """
    new = [
        structs.replace(
            instead.get(name)
            or run.placed.get(name, Incarnation(component=name, computer=computer)),
            computer=computer,
            epoch=run.next_epoch(name),
        )
        for name, computer in placement.items()
    ]
    new = [_with_checkpoint(run, incarnation) for incarnation in new]
    old = [run.placed[name] for name in sorted(placement.keys() & run.placed.keys())]
    lost = {incarnation.computer for incarnation in old}.intersection(lost)
    # one of the lost that comes back meanwhile must keep what it has
    ends = [incarnation for incarnation in old if incarnation.computer not in lost]
    desired = run.desired.without([incarnation.component for incarnation in ends])
    inactive = [incarnation.with_goal("inactive") for incarnation in new]
    try:
        run.commit(desired.with_coming(inactive), "start components together")
        run.wait(inactive, READY_LIMIT)
        for incarnation in ends:
            run.wait_ended(incarnation)
        _revoke_leases(run, lost)
        if run.agents.election is not None:
            # else a later leader would let what ran before go on beside them
            run.commit_lastingly(run.desired.placing(inactive), "the new placement")
    except RunError as error:
        run.journal.note("failed", f"components did not start: {error}")
        # computers may have been joined meanwhile: what is desired then stays
        mine = (None, *inactive)
        back = [each for each in old if run.placed.get(each.component) in mine]
        run.commit(
            run.desired.with_coming(()).placing(back),
            "components did not start: all is as it was",
        )
        return False
    # where they were, they have no lease any more
    run.commit(run.desired.placing(new), "components start together")
    try:
        run.wait(new, ACTIVE_LIMIT)
    except RunError as error:
        run.journal.note("failed", f"components did not start: {error}")
        if not lost:
            names = [incarnation.component for incarnation in new]
            run.commit(run.desired.without(names), "components did not start")
        return False
    run.journal.note("done", "the components run again", placement=run.placement())
    return True


def _revoke_leases(run: RunningComponents, lost: Collection[str]) -> None:
    """Wait until nothing of lost computers can be active there any more."""

    def is_back() -> bool:
        run.poll()
        return not run.computers().isdisjoint(lost)

    deadline = time.monotonic() + LEASES_END_WITHIN
    while not run.agents.revoke(lost):
        if run.agents.wait_news(is_back, _LOOK_EVERY):
            raise RunError(f"{_names(lost)} is reached again")
        if time.monotonic() > deadline:
            raise RunError(f"components of {_names(lost)} may still be at work")


def _names(computers: Collection[str]) -> str:
    return " or ".join(f"'{name}'" for name in sorted(computers))


def _with_checkpoint(run: RunningComponents, new: Incarnation) -> Incarnation:
    """Let an agent keep the state that a component has to go on from, if there is."""
    name, before = new.component, run.placed.get(new.component)
    copy = run.agents.checkpoints.get(name, before.epoch) if before else None
    if copy is None:
        if before is not None:
            _note_lost_state(run, before)
        return structs.replace(new, fresh=True)
    mine = structs.replace(copy, epoch=new.epoch)
    if refusal := run.agents.keep_checkpoint(new.computer, mine):
        what = f"the state of '{name}' could not be sent to '{new.computer}': {refusal}"
        run.journal.note("failed", f"{what}; it starts without")
        return structs.replace(new, fresh=True)
    what = f"component '{name}' goes on from its state of {copy.age:.1f} s ago"
    run.journal.note("done", what)
    return structs.replace(new, fresh=False)


def _note_lost_state(run: RunningComponents, before: Incarnation) -> None:
    """Journal that a component lost its state, if it had one; `status` shows it."""
    name = before.component
    has_checkpoint = bool(run.robot.component(name).checkpoint)
    has_state = any(
        at == before.computer and c.name == name and c.has_state
        for at, c in located(run.agents.statuses())
    )
    if not (has_checkpoint or has_state):
        return
    why = "it has no `checkpoint` in the robot file"
    if has_checkpoint:
        why = "this manager has no copy of its checkpoint"
    lost = f"without the state that it had on '{before.computer}': {why}"
    what = f"component '{name}' started {lost}"
    run.journal.note("wrong", what)
    run.lost_states[name] = Deviation(
        what=what, computer=before.computer, component=name, since=wall_time()
    )


def transit(
    run: RunningComponents, steps: tuple[TransitionStep, ...]
) -> TransitionReport:
    """Take the steps of a planned transition; roll all back when one fails."""
    what = f"transition of {counted(len(steps), 'step')}"
    run.journal.note("decided", what, steps=steps)
    transition = _Transition(run)
    for number, step in enumerate(steps):
        if why := transition.execute(step):
            reason = (
                f"step '{step}' failed: {why}{transition.roll_back(steps[:number])}"
            )
            run.journal.note("failed", f"transition rolled back; {reason}")
            moves = tuple(transition.moves)
            return TransitionReport(
                steps=steps, committed=False, reason=reason, moves=moves
            )
    run.journal.note("done", "transition", placement=run.placement())
    return TransitionReport(steps=steps, committed=True, moves=tuple(transition.moves))


class _Transition:
    """Takes the steps of one transition; a step that fails changes nothing."""

    def __init__(self, run: RunningComponents) -> None:
        self.moves: list[MigrationReport] = []
        self._run = run
        # what is started again may have been replaced since the robot began
        self._ended: dict[str, Incarnation] = {}

    def execute(self, step: TransitionStep) -> str:
        """Take a step; return why it failed, or an empty text."""
        try:
            if not step.source:
                self._start(step.component, step.target)
            elif not step.target:
                self._stop(step.component)
            else:
                report = plan_move(self._run, step.component, step.target).run()
                self.moves.append(report)
                return report.reason
        except (RunError, UsageError) as error:
            return str(error)
        return ""

    def roll_back(self, taken: Sequence[TransitionStep]) -> str:
        """Undo the steps that were taken, last first; return what went wrong there."""
        troubles = ""
        for step in reversed(taken):
            if reason := self.execute(step.inverse()):
                troubles += f"; rolling back '{step}' failed: {reason}"
        return troubles

    def _start(self, component: str, computer: str) -> None:
        run = self._run
        before = self._ended.get(component)
        new = Incarnation(
            component=component,
            computer=computer,
            epoch=run.next_epoch(component),
            implementation=before.implementation if before else "",
            code=before.code if before else "",
        )
        try:
            inactive = [new.with_goal("inactive")]
            run.bring(inactive, READY_LIMIT, f"prepare '{component}'")
            run.bring([new], ACTIVE_LIMIT, f"activate '{component}'")
        except RunError as error:
            run.commit(run.desired.with_coming(()), f"it does not start: {error}")
            raise
        run.commit(run.desired.placing([new]), f"'{component}' is at work")

    def _stop(self, component: str) -> None:
        run = self._run
        old = run.placed[component]
        self._ended[component] = old
        run.commit(run.desired.without([component]), f"end '{component}'")
        try:
            run.wait_ended(old)
        except RunError as error:
            # the old one has lost its state by now, if it listens at all
            again = structs.replace(old, epoch=run.next_epoch(component))
            run.commit(run.desired.placing([again]), f"it does not end: {error}")
            raise
