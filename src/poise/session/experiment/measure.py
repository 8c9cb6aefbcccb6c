"""Runs a robot once for the experiment, and measures it from outside."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping

from msgspec.structs import replace

from poise.errors import PoiseError, RunError
from poise.manage.agent_connections.statuses import Statuses, components_of
from poise.manage.observe.chains import chain_reports
from poise.manage.tasks.progress import OVER
from poise.model.robot import Robot
from poise.session.callbacks import Check, nothing
from poise.session.experiment.results import Missed, TrialResult
from poise.session.experiment.trials import (
    Arm,
    Trial,
    TrialCondition,
    as_it_runs,
    under,
)
from poise.session.placing.placement import place
from poise.session.profiling.machine_speed import as_when_profiled
from poise.session.reports.history import cpu_shares
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
    blank = TrialResult(trial=trial, at=time.time(), host_load=os.getloadavg()[0])
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


class DeadlineCounts:
    """Counts deadlines over all incarnations of components that move."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._chains: dict[tuple[str, int], Missed] = {}
        self._timers: dict[tuple[str, int], Missed] = {}

    def look(self, statuses: Statuses) -> None:
        """Take the counts so far."""
        for chain in chain_reports(self._robot, statuses):
            if chain.age.count:
                self._chains[chain.name, chain.hops[-1].epoch] = Missed(
                    of=chain.age.count,
                    missed=chain.missed,
                    median=chain.age.median,
                    p99=chain.age.p99,
                )
        for component in components_of(statuses):
            for timer in component.timers:
                if timer.deadline is not None:
                    key = f"{component.name}.{timer.name}", component.epoch
                    self._timers[key] = Missed(of=timer.releases, missed=timer.missed)

    def chains(self) -> dict[str, Missed]:
        """Return chain -> its counts; ages are those of the longest stay."""
        return _over_epochs(self._chains)

    def timers(self) -> dict[str, Missed]:
        """Return ``component.timer`` -> its counts."""
        return _over_epochs(self._timers)


def _over_epochs(counts: Mapping[tuple[str, int], Missed]) -> dict[str, Missed]:
    found: dict[str, Missed] = {}
    for (name, _), each in sorted(counts.items(), key=lambda item: item[1].of):
        before = found.get(name, Missed(of=0, missed=0))
        found[name] = replace(
            each, of=before.of + each.of, missed=before.missed + each.missed
        )
    return found


def _watched(
    running: Up, task: str, placed: TrialResult, seconds: float, check: Check
) -> TrialResult:
    run, computers, world = (
        running.started.run,
        running.started.computers,
        running.started.world,
    )
    counts, moves, where = DeadlineCounts(run.robot), 0, run.placement()
    computers.begin()
    waited = world.waited() if world is not None else 0.0
    begin, began = run.agents.statuses(), time.monotonic()
    while (now := time.monotonic() - began) < seconds:
        check()
        if running.wait(min(_LOOK_EVERY, seconds - now)):
            raise RunError("the robot was stopped")
        if world is not None and world.has_ended():
            raise RunError(f"the simulated world ended after {now:.1f} s")
        computers.look()
        counts.look(run.agents.statuses())
        places = run.placement()
        moves += sum(where.get(name, at) != at for name, at in places.items())
        where = places
        if running.tasks.show(task).state in OVER:
            break
    waited = world.waited() - waited if world is not None else 0.0
    end = run.agents.statuses()
    counts.look(end)
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
        chains=counts.chains(),
        timers=counts.timers(),
        cpu_share=cpu_shares(run.robot, begin, end, computers.faster),
        moves=moves,
        world_waited=waited,
    )
