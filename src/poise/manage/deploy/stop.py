"""Stops a robot's components, on all computers that are reached."""

from __future__ import annotations

import contextlib

from poise.errors import RunError
from poise.manage.deploy.deactivation import deactivate_callers
from poise.manage.deploy.running_components import RunningComponents

RETURN_LIMIT = 3.0
"""A stop waits this long for computers that are out of reach [s]."""


def stop(run: RunningComponents) -> None:
    """Stop everything, callers first, on all computers that are reached.

    Computers that come back within `RETURN_LIMIT` are stopped, too. Harmless when
    repeated, and where another manager has the robot.

    Raises
    ------
    RunError
        Something still runs: after `STOP_LIMIT`, or out of reach.
    """
    if run.is_left or run.desired.is_stopped:
        return
    agents, run.goes_on_without_lost = run.agents, True
    with contextlib.suppress(RunError):  # it is only for quiet
        deactivate_callers(run)
    away = {computer.name for computer in run.robot.computers} - run.computers()
    run.end_all("the robot is stopped")
    if away:
        agents.wait_news(lambda: away <= run.computers(), RETURN_LIMIT)
        if not away.isdisjoint(run.computers()):
            run.end_all("computers that are back are stopped")
    text = "; ".join(
        f"{sentence}; `poise stop --file FILE` ends it once '{name}' is reached"
        for name, sentence in run.unreached().items()
    )
    if text:
        run.journal.note("failed", f"stopped, but: {text}")
        raise RunError(f"stopped, but: {text}")
    run.journal.note("done", "everything stopped")
