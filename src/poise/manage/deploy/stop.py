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
    if run.is_left:
        return
    run.leave()
    agents = run.agents
    run.excused |= agents.out_of_reach().keys()
    with contextlib.suppress(RunError):  # it is only for quiet
        deactivate_callers(run)
    reached = run.computers()
    run.reclaim({name for name in reached if not agents.obey(name)})
    run.end_all(reached)
    away = {computer.name for computer in run.robot.computers} - reached
    if away:
        agents.wait_news(lambda: away <= run.computers(), RETURN_LIMIT)
        returned = away & run.computers()
        run.reclaim(returned)
        run.end_all(returned)
    text = "; ".join(
        f"{sentence}; `poise stop --file FILE` ends it once '{name}' is reached"
        for name, sentence in run.unreached().items()
    )
    if text:
        run.journal.note("failed", f"stopped, but: {text}")
        raise RunError(f"stopped, but: {text}")
    run.journal.note("done", "everything stopped")
