"""Starts a robot, or takes over one that an earlier manager left at work."""

from __future__ import annotations

import contextlib
import itertools
import secrets
import time
from collections.abc import Collection, Mapping, Sequence

from poise.errors import PoiseError, RobotError, RunError
from poise.manage.adaptation.facts import Facts
from poise.manage.adaptation.shortages.free_room import placed_beside
from poise.manage.deploy.adoption import Adoption, Found, adopt, found_in, is_half_done
from poise.manage.deploy.incarnation import Incarnation
from poise.manage.deploy.running_components import (
    ACTIVE_LIMIT,
    READY_LIMIT,
    RunningComponents,
)
from poise.manage.migration.transition import plan_transition
from poise.manage.migration.transition_run import transit
from poise.model.check.allowed_computers import allowed_computers
from poise.units import counted
from poise.wire.records.deployment import Deployment
from poise.wire.records.migration import MigrationSteps, Step, StepsDone

HALT_LIMIT = 1.0
"""Containers say within this time how far a half-done migration came [s]."""


def start_or_take_over(
    run: RunningComponents, *, is_rule: bool = False, by_force: bool
) -> None:
    """Bring a robot up: what runs as it should goes on, and the rest is started.

    Parameters
    ----------
    is_rule
        Whether the user asked for the placement; else what runs stays where it is.
    by_force
        Whether agents are to obey though another manager is alive.

    Raises
    ------
    RunError
        Another manager is at work; or nothing ran, and it cannot start. A robot that
        is at work goes on.
    """
    before = [status.manager for status in run.agents.statuses().values()]
    deployments, unclaimed = _claim(run, by_force=by_force)
    found = found_in(deployments)
    if not found:
        if unclaimed:
            run.leave()  # what runs there may be another manager's
            raise RunError("; ".join(unclaimed.values()))
        run.start_all()
        return
    said = next((f" of {manager}" for manager in before if manager), "")
    run.journal.note("seen", f"the robot{said} runs: taking over")
    try:
        _take_over(run, deployments, unclaimed, found, is_rule=is_rule)
    except Exception:
        run.leave()  # no error of a new manager ends a robot that is at work
        raise


def _take_over(
    run: RunningComponents,
    deployments: Mapping[str, Deployment],
    unclaimed: Mapping[str, str],
    found: Sequence[Found],
    *,
    is_rule: bool,
) -> None:
    began = time.monotonic()
    last = max(deployments.values(), key=lambda d: d.generation, default=None)
    tasks = last.tasks if last else b""
    # what comes back from now on is claimed and told then
    run.goes_on_without_lost = True
    planned = run.placement()
    if tasks and not is_rule:
        # the tasks go on where they are, and say themselves what they need
        planned = _at_work(run, found, deployments.keys())
    is_committed = is_half_done(found, run.robot) and _is_committed(run, deployments)
    adoption = adopt(
        found,
        run.robot,
        run.layout,
        planned,
        is_committed=is_committed,
        keeps=not is_rule,
    )
    _note(run, adoption)
    run.adopt(adoption.kept, _last_epochs(found), tasks)
    for sentence in (*unclaimed.values(), *run.unreached().values()):
        run.journal.note("wrong", sentence)
    seconds = time.monotonic() - began
    run.journal.note("done", "took over", placement=run.placement(), seconds=seconds)
    _start(run, adoption, found, deployments.keys())
    if is_rule:
        _move(run, planned)


def _at_work(
    run: RunningComponents, found: Sequence[Found], claimed: Collection[str]
) -> dict[str, str]:
    """Return what works, with what its architectures lack, and layers that never stop.

    What works stays where it is, if it still may. What is lacking may be at work on a
    computer that is out of reach: it counts as there, if it is allowed there, so that
    it is not started twice. Else it goes where there is room. What only rests ends.
    """
    allowed, planned = allowed_computers(run.robot), run.placement()
    away = {c.name for c in run.robot.computers} - set(claimed)
    works = {e.name: e.computer for e in found if e.spec.goal != "inactive"}
    homes: dict[str, tuple[str, ...]] = {}
    for architecture in run.robot.architectures:
        names = [component.name for component in architecture.components]
        stays = architecture.layer != "sequencing" and planned.keys() >= set(names)
        if not stays and works.keys().isdisjoint(names):
            continue
        for name in names:
            may = allowed[name] & away or allowed[name]
            if works.get(name) in allowed[name]:
                homes[name] = (works[name],)
            elif planned.get(name) in may:
                homes[name] = (planned[name],)
            else:
                homes[name] = tuple(sorted(may))
    facts = Facts(robot=run.robot, task="", placement=planned)
    with contextlib.suppress(RobotError):  # all is as full as it was
        return {
            **{name: may[0] for name, may in homes.items()},
            **placed_beside(facts, homes).placement,
        }
    return {name: may[0] for name, may in homes.items()}


def _is_committed(
    run: RunningComponents, deployments: Mapping[str, Deployment]
) -> bool:
    """Return whether a half-done migration was committed; nothing of it goes on then.

    A container that began a step after the commit knows. When none did, the migration
    can be rolled back.
    """
    numbers = itertools.count(secrets.randbits(48))
    batches = [
        (
            computer,
            MigrationSteps(
                next(numbers), 0, container.name, (Step("halt"),), HALT_LIMIT
            ),
        )
        for computer, deployment in deployments.items()
        for container in deployment.containers
    ]
    outcomes = list(run.agents.take_steps(batches))
    for outcome in outcomes:
        if not isinstance(outcome, StepsDone):
            run.journal.note("seen", f"amid a migration, {outcome.reason}")
    return any(isinstance(o, StepsDone) and o.is_committed for o in outcomes)


def _last_epochs(found: Sequence[Found]) -> dict[str, int]:
    epochs: dict[str, int] = {}
    for each in found:
        epochs[each.name] = max(each.spec.epoch, epochs.get(each.name, 0))
    return epochs


def _note(run: RunningComponents, adoption: Adoption) -> None:
    for sentence in adoption.half_done:
        run.journal.note("decided", sentence)
    for name, reason in adoption.restarts.items():
        run.journal.note("decided", f"component '{name}' restarts: {reason}")
    for name in adoption.ends:
        run.journal.note("decided", f"component '{name}' ends: the task needs it not")
    kept = counted(len(adoption.kept), "component")
    run.journal.note("decided", f"{kept} go on as they run", kept=sorted(adoption.kept))


def _start(
    run: RunningComponents,
    adoption: Adoption,
    found: Sequence[Found],
    claimed: Collection[str],
) -> None:
    """Start what does not go on; what cannot start is a deviation from then on."""
    starts = [
        Incarnation(component=name, computer=computer, epoch=run.next_epoch(name))
        for name, computer in adoption.starts.items()
    ]
    # what is out of reach starts elsewhere, if it may, or once it is reached
    new = [each for each in starts if each.computer in claimed]
    if not starts:
        return
    try:
        for each in found:
            if each.name in adoption.restarts:
                run.wait_ended(each.incarnation)
        inactive = [each.with_goal("inactive") for each in new]
        run.bring(inactive, READY_LIMIT, "start what is missing")
        run.bring(new, ACTIVE_LIMIT, "activate what is missing")
        if new:
            run.journal.note("done", f"started {counted(len(new), 'component')}")
    except RunError as error:
        run.journal.note("failed", f"not all that is missing started: {error}")
    run.commit(run.desired.placing(starts), "what is missing belongs there")


def _claim(
    run: RunningComponents, *, by_force: bool
) -> tuple[dict[str, Deployment], dict[str, str]]:
    """Return what the agents work towards, and why some were not claimed.

    Those are claimed once they answer.
    """
    deployments: dict[str, Deployment] = {}
    unclaimed: dict[str, str] = {}
    computers = sorted(run.computers())
    for computer in computers:
        try:
            deployments |= run.agents.claim({computer}, take_over=by_force)
        except RunError as error:
            unclaimed[computer] = str(error)
            if computer == computers[0] and computer in run.computers():
                break  # another manager has the robot
    if computers and computers[0] in unclaimed and not deployments:
        run.leave()
        hint = "`poise up --take-over` takes the robot over"
        raise RunError(f"{unclaimed[computers[0]]}; {hint}")
    return deployments, unclaimed


def _move(run: RunningComponents, wanted: Mapping[str, str]) -> None:
    """Move what was kept to where the user wants it."""
    try:
        steps = plan_transition(run.robot, run.placement(), wanted)
        if steps:
            transit(run, steps)
    except PoiseError as error:
        run.journal.note("failed", f"the placement stays as it is: {error}")
