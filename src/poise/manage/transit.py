"""Takes the steps of a transition, and takes them back when one fails."""

from __future__ import annotations

from collections.abc import Sequence

from msgspec import Struct

from poise.errors import RunError
from poise.manage.deployment import Incarnation
from poise.manage.move import MoveReport, move
from poise.manage.run import ACTIVE_LIMIT, READY_LIMIT, STOP_LIMIT, Run
from poise.manage.transition import Step


class TransitionReport(Struct, frozen=True, kw_only=True):
    """How a transition went.

    Parameters
    ----------
    steps
        What was planned.
    committed
        Whether the new placement stands; else the old one does again.
    reason
        Why not; also when a step back failed.
    moves
        The moves that were made, in order, those back included.
    """

    steps: tuple[Step, ...]
    committed: bool
    reason: str = ""
    moves: tuple[MoveReport, ...] = ()


def transit(run: Run, steps: tuple[Step, ...]) -> TransitionReport:
    """Take the steps of a planned transition; when one fails, take all back."""
    run.journal.note("decided", f"transition of {len(steps)} steps", steps=steps)
    moves: list[MoveReport] = []
    for number, step in enumerate(steps):
        reason = _try(run, step, moves)
        if reason:
            reason = f"step '{step}' failed: {reason}"
            reason += _go_back(run, steps[:number], moves)
            run.journal.note("failed", f"transition called off; {reason}")
            return TransitionReport(
                steps=steps, committed=False, reason=reason, moves=tuple(moves)
            )
    run.journal.note("done", "transition", placement=run.placement())
    return TransitionReport(steps=steps, committed=True, moves=tuple(moves))


def _go_back(run: Run, taken: Sequence[Step], moves: list[MoveReport]) -> str:
    """Undo the steps that were taken, last first; return what went wrong thereby."""
    troubles = ""
    for step in reversed(taken):
        reason = _try(run, _inverse(step), moves)
        if reason:
            troubles += f"; taking back '{step}' failed: {reason}"
    return troubles


def _inverse(step: Step) -> Step:
    kind = {"start": "stop", "stop": "start", "move": "move"}[step.kind]
    return Step(
        kind=kind,  # type: ignore[arg-type] # a dict of literals widens to str
        component=step.component,
        source=step.target,
        target=step.source,
    )


def _try(run: Run, step: Step, moves: list[MoveReport]) -> str:
    """Take a step; return why it failed, or an empty text."""
    try:
        match step.kind:
            case "move":
                report = move(run, step.component, step.target)
                moves.append(report)
                return report.reason
            case "start":
                _start(run, step)
            case "stop":
                _stop(run, step)
    except RunError as error:
        return str(error)
    return ""


def _start(run: Run, step: Step) -> None:
    new = Incarnation(
        component=step.component,
        computer=step.target,
        epoch=run.next_epoch(step.component),
    )
    run.placed[step.component] = new
    others = [each for each in run.placed.values() if each != new]
    ready = new.with_goal("inactive")
    for wanted, limit in ((ready, READY_LIMIT), (new, ACTIVE_LIMIT)):
        run.tell([*others, wanted], run.computers())
        run.wait([wanted], limit)


def _stop(run: Run, step: Step) -> None:
    gone = run.placed.pop(step.component)
    run.tell(run.placed.values(), run.computers())
    if not run.fleet.wait_news(lambda: run.has_ended(gone), STOP_LIMIT):
        raise RunError(f"component '{step.component}' still runs")
