"""Takes the steps of a transition, and rolls them back when one fails."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial

from msgspec import structs

from poise.errors import RunError, UsageError
from poise.manage.agent_connections.statuses import located
from poise.manage.deploy.desired import Incarnation
from poise.manage.deploy.live_robot import ACTIVE_LIMIT, READY_LIMIT, LiveRobot
from poise.manage.migration.migration_report import (
    MigrationReport,
    TransitionReport,
    TransitionStep,
)
from poise.manage.migration.move import hand_checkpoint, plan_move
from poise.units import counted


def start_together(
    live: LiveRobot,
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
            instead.get(name) or live.placed.get(name) or begun,
            computer=computer,
            epoch=begun.epoch,
        )
        for name, computer in placement.items()
        for begun in [live.begun(name, computer)]
    ]
    handed = [_hand_checkpoint(live, incarnation) for incarnation in new]
    new = [incarnation for incarnation, _ in handed]
    notes = {incarnation.component: note for incarnation, note in handed}
    old = [live.placed[name] for name in sorted(placement.keys() & live.placed.keys())]
    lost = {incarnation.computer for incarnation in old}.intersection(lost)
    # one of the lost that comes back meanwhile must keep what it has
    ends = [incarnation for incarnation in old if incarnation.computer not in lost]
    for each in ends:
        notes[each.component]()
    desired = live.desired.without([incarnation.component for incarnation in ends])
    inactive = [incarnation.with_goal("inactive") for incarnation in new]
    try:
        live.commit(desired.with_coming(inactive), "start components together")
        live.wait(inactive, READY_LIMIT)
        for incarnation in ends:
            live.wait_ended(incarnation)
        live.end_left_behind(new, lost)
        if live.agents.election is not None:
            # else a later leader would let what ran before go on beside them
            live.commit_lastingly(live.desired.placing(inactive), "the new placement")
    except RunError as error:
        live.journal.note("failed", f"components did not start: {error}")
        # computers may have been joined meanwhile: what is desired then stays
        mine = [e.component for e in inactive if live.placed.get(e.component) == e]
        desired = live.desired.without(mine)
        back = [each for each in old if each.component not in desired.placed]
        live.commit(desired.placing(back), "components did not start: all is as it was")
        return False
    # where they were, they have no lease any more
    live.commit(live.desired.placing(new), "components start together")
    for each in old:
        if each.computer in lost:
            notes[each.component]()
    try:
        live.wait(new, ACTIVE_LIMIT)
    except RunError as error:
        live.journal.note("failed", f"components did not start: {error}")
        if not lost:
            names = [incarnation.component for incarnation in new]
            live.commit(live.desired.without(names), "components did not start")
        return False
    live.journal.note("done", "the components run again", placement=live.placement())
    return True


def _hand_checkpoint(
    live: LiveRobot, new: Incarnation
) -> tuple[Incarnation, Callable[[], None]]:
    """Return it with what was kept of what is placed, and what journals its state."""
    before = live.placed.get(new.component)
    if before is None:
        return hand_checkpoint(live, new, None)
    kept = live.agents.checkpoints.get(before.component, before.epoch)
    new, note = hand_checkpoint(live, new, kept)
    if kept is None and (lost := _lost_state(live, before)):
        note = partial(live.note_lost_state, before.component, before.computer, lost)
    return new, note


def _lost_state(live: LiveRobot, before: Incarnation) -> str:
    """Return why what has no checkpoint loses its state; empty: it had none."""
    name = before.component
    has_state = any(
        at == before.computer and c.name == name and c.has_state
        for at, c in located(live.agents.statuses())
    )
    if not (has_state or live.robot.component(name).checkpoint):
        return ""
    lost = f"component '{name}' started without the state that it had on "
    return f"{lost}'{before.computer}': {live.why_no_checkpoint(name)}"


def transit(live: LiveRobot, steps: tuple[TransitionStep, ...]) -> TransitionReport:
    """Take the steps of a planned transition; roll all back when one fails."""
    what = f"transition of {counted(len(steps), 'step')}"
    live.journal.note("decided", what, steps=steps)
    moves: list[MigrationReport] = []
    reason = ""
    for number, step in enumerate(steps):
        if why := _execute(live, step, moves):
            troubles = _roll_back(live, steps[:number], moves)
            reason = f"step '{step}' failed: {why}{troubles}"
            live.journal.note("failed", f"transition rolled back; {reason}")
            break
    else:
        live.journal.note("done", "transition", placement=live.placement())
    return TransitionReport(
        steps=steps, committed=not reason, reason=reason, moves=tuple(moves)
    )


def _execute(
    live: LiveRobot, step: TransitionStep, moves: list[MigrationReport]
) -> str:
    """Take a step, which changes nothing when it fails; return why it did."""
    try:
        if not step.source:
            _start(live, step.component, step.target)
        elif not step.target:
            _stop(live, step.component)
        else:
            report = plan_move(live, step.component, step.target).run()
            moves.append(report)
            return report.reason
    except (RunError, UsageError) as error:
        return str(error)
    return ""


def _roll_back(
    live: LiveRobot, taken: Sequence[TransitionStep], moves: list[MigrationReport]
) -> str:
    """Undo the steps that were taken, last first; return what went wrong there."""
    troubles = ""
    for step in reversed(taken):
        if reason := _execute(live, step.inverse(), moves):
            troubles += f"; rolling back '{step}' failed: {reason}"
    return troubles


def _start(live: LiveRobot, component: str, computer: str) -> None:
    new = live.begun(component, computer)
    try:
        live.bring([new.with_goal("inactive")], READY_LIMIT, f"prepare '{component}'")
        live.end_left_behind([new])
        live.bring([new], ACTIVE_LIMIT, f"activate '{component}'")
    except RunError as error:
        live.commit(live.desired.with_coming(()), f"it does not start: {error}")
        raise
    live.commit(live.desired.placing([new]), f"'{component}' is at work")


def _stop(live: LiveRobot, component: str) -> None:
    old = live.placed[component]
    live.commit(live.desired.without([component]), f"end '{component}'")
    try:
        live.wait_ended(old)
    except RunError as error:
        # the old one has lost its state by now, if it listens at all
        again = structs.replace(old, epoch=live.next_epoch(component))
        live.commit(live.desired.placing([again]), f"it does not end: {error}")
        raise
