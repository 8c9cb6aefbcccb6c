"""From the components of some actions to those of the next: at work, or prepared.

A prepared component is configured, inactive and joined to nothing. It keeps its state
and uses memory, but no CPU; it becomes active within moments.
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterable, Mapping

from msgspec.structs import replace

from poise.errors import RunError
from poise.manage.agent_connections.statuses import components_of
from poise.manage.deploy.incarnation import Incarnation
from poise.manage.deploy.running_components import (
    ACTIVE_LIMIT,
    READY_LIMIT,
    RunningComponents,
)
from poise.wire.records.status import State


def prepare(run: RunningComponents, placement: Mapping[str, str]) -> None:
    """Let components be prepared on computers; return before they are.

    What is prepared elsewhere is dropped there; what is at work stays as it is.

    They take only the CPU time that others leave.

    Raises
    ------
    RunError
        An agent refused or did not answer; nothing more is prepared then.
    """
    before = dict(run.prepared)
    for name, computer in placement.items():
        if name not in run.placed:
            run.prepared[name] = _prepared(run, name, computer, gently=True)
    try:
        run.tell(run.placed.values())
    except RunError:
        run.prepared = before
        with contextlib.suppress(RunError):  # agents out of reach get it later
            run.tell(run.placed.values())
        raise


def drop(run: RunningComponents, components: Iterable[str]) -> None:
    """End prepared components; their state is lost."""
    gone = [name for name in components if run.prepared.pop(name, None)]
    if gone:
        run.tell(run.placed.values())


def switch(
    run: RunningComponents, ends: Collection[str], begins: Mapping[str, str]
) -> bool:
    """Let components rest, prepared, and others begin to work.

    Returns whether all of these were prepared.

    Parameters
    ----------
    ends
        Components at work.
    begins
        Component -> computer. What is prepared there already only becomes active.

    Raises
    ------
    RunError
        Something did not begin within the limits: then nothing of `begins` works, and
        all of `ends` rests.
    """
    are_ready = _are_ready(run, begins)
    for name in ends:
        old = run.placed.pop(name)
        run.prepared[name] = replace(old, goal="inactive", unjoined=True, gently=False)
    new = [
        replace(_prepared(run, name, at), unjoined=False, gently=False)
        for name, at in begins.items()
    ]
    resting = [run.prepared[name] for name in ends]
    run.prepared |= {each.component: each for each in new}
    try:
        run.tell(run.placed.values())
        _wait(run, [*resting, *new], READY_LIMIT)
        active = [each.with_goal("active") for each in new]
        run.tell([*run.placed.values(), *active])
        _wait(run, active, ACTIVE_LIMIT)
        for each in active:
            del run.prepared[each.component]
            run.placed[each.component] = each
    except RunError:
        for each in new:
            run.prepared.pop(each.component, None)
        with contextlib.suppress(RunError):  # agents out of reach get it later
            run.tell(run.placed.values())
        raise
    return are_ready


def _are_ready(run: RunningComponents, components: Mapping[str, str]) -> bool:
    """Return whether all of some components are prepared where they are to work."""
    states = _states(run)
    return all(
        (each := run.prepared.get(name)) is not None
        and each.computer == computer
        and states.get((name, each.epoch)) == "inactive"
        for name, computer in components.items()
    )


def _states(run: RunningComponents) -> dict[tuple[str, int], State]:
    return {(c.name, c.epoch): c.state for c in components_of(run.current())}


def _prepared(
    run: RunningComponents, name: str, computer: str, *, gently: bool = False
) -> Incarnation:
    before = run.prepared.get(name)
    if (
        before is not None
        and before.computer == computer
        and _states(run).get((name, before.epoch)) != "failed"
    ):
        return before
    return Incarnation(
        component=name,
        computer=computer,
        epoch=run.next_epoch(name),
        goal="inactive",
        gently=gently,
        unjoined=True,
    )


def _wait(
    run: RunningComponents, wanted: Collection[Incarnation], limit: float
) -> None:
    """Wait until components are at their goals; others' troubles do not count."""
    mine = {(each.component, each.epoch) for each in wanted}

    def trouble() -> bool:
        run.look()
        for component in components_of(run.agents.statuses()):
            is_mine = (component.name, component.epoch) in mine
            if is_mine and component.state == "failed":
                raise RunError(
                    f"component '{component.name}' failed:\n{component.error}"
                )
        return False

    run.wait(wanted, limit, trouble)
