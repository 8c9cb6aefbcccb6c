"""Runs a robot once for the experiment, and measures it from outside.

It imports internal modules: it measures runs from outside.
"""

from __future__ import annotations

import os
import time

from msgspec.structs import replace

from benchmarks.experiment.results import (
    Arm,
    Missed,
    Trial,
    TrialCondition,
    TrialResult,
    as_it_runs,
    under,
)
from poise.clock import wall_time
from poise.errors import PoiseError, RunError
from poise.manage.agent_connections.statuses import Statuses, components_of
from poise.manage.observe.chains import chain_reports
from poise.manage.tasks.task_progress import OVER
from poise.model.robot import Robot
from poise.session.callbacks import Check, nothing
from poise.session.placing.placement import place
from poise.session.profiling.stored_profiles import as_when_profiled
from poise.session.reports.history import cpu_shares
from poise.session.reports.last_seen import LastSeen
from poise.session.up import Up, up

_LOOK_EVERY = 0.2
_TOLERATED = 0.1
"""A run is invalid when the simulated world waited for a CPU for more than this share
of it: then it is no world in real time."""
_BULKY = {"functions", "path", "walls", "goal"}
"""What of the world's results is not kept beside the others."""


def measure(
    robot: Robot,
    task: str,
    arm: Arm,
    condition: TrialCondition,
    seed: int,
    seconds: float,
    check: Check,
) -> TrialResult:
    """Return what a run showed; why it is invalid when it broke.

    It is measured until its task is over, for so many seconds at most.
    """
    known = under(robot, condition)
    trial = Trial(arm.name, condition.name, seed)
    blank = TrialResult(trial=trial, at=wall_time(), host_load=os.getloadavg()[0])
    try:
        placed = place(
            known, task, method=arm.method.format(seed=seed), seed=seed, fewer=True
        )
        blank = replace(
            blank,
            placement=placed.where,
            decision_seconds=placed.result.seconds,
            put_aside=placed.result.aside,
        )
        with up(
            as_when_profiled(as_it_runs(known, arm, condition, seed)),
            task,
            placement=placed,
            adapt=arm.adapts,
            say=nothing,  # what a hundred runs have to tell is in their results
            check=check,
        ) as running:
            return _watched(running, task, blank, seconds, check)
    except PoiseError as error:
        return replace(blank, invalid=f"the run broke: {error}")


def _watched(
    running: Up, task: str, placed: TrialResult, seconds: float, check: Check
) -> TrialResult:
    run, computers, world = (
        running.started.run,
        running.started.computers,
        running.started.world,
    )
    seen, moves, where = LastSeen(), 0, run.placement()
    computers.begin()
    waited = world.waited() if world is not None else 0.0
    run.agents.on_status = seen.take
    begin, began = run.agents.statuses(), time.monotonic()
    seen.look(begin)
    while (now := time.monotonic() - began) < seconds:
        check()
        if running.wait(min(_LOOK_EVERY, seconds - now)):
            raise RunError("the robot was stopped")
        if world is not None and world.has_ended():
            raise RunError(f"the simulated world ended after {now:.1f} s")
        computers.look()
        places = run.placement()
        moves += sum(where.get(name, at) != at for name, at in places.items())
        where = places
        if running.tasks.show(task).state in OVER:
            break
    now = time.monotonic() - began
    waited = world.waited() - waited if world is not None else 0.0
    end = run.agents.statuses()
    final = seen.merged(end)
    invalid = computers.end()
    if not invalid and waited > _TOLERATED * now:
        invalid = f"the simulated world waited {waited:.1f} s for a CPU of this machine"
    said = dict(world.result()) if world is not None else {}
    return replace(
        placed,
        invalid=invalid,
        seconds=now,
        functions=said.get("functions", {}),
        world={name: said[name] for name in said.keys() - _BULKY},
        chains=_chains(run.robot, final),
        timers=_timers(final),
        cpu_share=cpu_shares(run.robot, begin, end, computers.faster),
        moves=moves,
        world_waited=waited,
    )


def _chains(robot: Robot, statuses: Statuses) -> dict[str, Missed]:
    return {
        each.name: Missed(
            of=each.age.count,
            missed=each.missed,
            median=each.age.median,
            p99=each.age.p99,
        )
        for each in chain_reports(robot, statuses)
        if each.age.count
    }


def _timers(statuses: Statuses) -> dict[str, Missed]:
    return {
        f"{component.name}.{timer.name}": Missed(of=timer.releases, missed=timer.missed)
        for component in components_of(statuses)
        for timer in component.timers
        if timer.deadline is not None
    }
