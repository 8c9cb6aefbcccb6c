"""Runs a robot once for the experiment, and measures it from outside.

It imports internal modules: it measures runs from outside.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

import yaml
from msgspec.structs import replace

from benchmarks.experiment.balancers import BALANCERS, balanced
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
from poise.emulate.cpu_load import background_load
from poise.errors import PoiseError, RunError
from poise.manage.agent_connections.statuses import Statuses, components_of
from poise.manage.observe.chains import chain_reports
from poise.manage.tasks.task_reports import OVER
from poise.model.robot import Robot
from poise.session import Check, nothing
from poise.session.last_seen import LastSeen
from poise.session.placing.placement import Placement, place
from poise.session.profiling.stored_profiles import as_when_profiled, loops
from poise.session.run_records import cpu_shares
from poise.session.up import Up, up

_LOOK_EVERY = 0.2
_TOLERATED = 0.1
"""A run is invalid when the simulated world waited for a CPU for more than this share
of it: then it is no world in real time."""
_STOLEN = 0.02
"""A run is invalid when a hypervisor took more than this share of the CPU."""
_CHANGED = 0.05
"""A run is invalid when the machine's speed changed by more than this meanwhile."""
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
    trial = Trial(arm.name, condition.name, seed)
    blank = TrialResult(
        trial=trial, at=wall_time(), host_load=os.getloadavg()[0], speeds=(loops(),)
    )
    try:
        known = under(robot, condition, task)
        placed = _placed(known, task, arm, seed)
        blank = replace(
            blank,
            placement=placed.where,
            decision_seconds=placed.result.seconds,
            suspended=placed.result.suspended,
        )
        with up(
            as_when_profiled(as_it_runs(known, arm, condition, seed)),
            task,
            placement=placed,
            adapt=arm.adapts,
            say=nothing,  # what a hundred runs have to tell is in their results
            check=check,
        ) as running:
            result = _watched(running, task, condition, blank, seconds, check)
        return _at_one_speed(replace(result, speeds=(*result.speeds, loops())))
    except PoiseError as error:
        return replace(blank, invalid=f"the run broke: {error}")


def _placed(robot: Robot, task: str, arm: Arm, seed: int) -> Placement:
    if arm.method not in BALANCERS:
        method = arm.method.format(seed=seed)
        return place(robot, task, method=method, seed=seed, fewer=True)
    with tempfile.TemporaryDirectory(prefix="poise-") as folder:
        file = Path(folder) / "placement.yaml"
        file.write_text(yaml.safe_dump(balanced(robot, task, arm.method)))
        return place(robot, task, method=str(file))


def _at_one_speed(result: TrialResult) -> TrialResult:
    """Return a result; invalid, if the machine was not the same all the time."""
    low, high = min(result.speeds), max(result.speeds)
    if result.invalid or high <= low * (1 + _CHANGED):
        return result
    why = f"the machine's speed changed by {high / low - 1:.0%} meanwhile"
    return replace(result, invalid=why)


def _cpu_times() -> tuple[float, float]:
    """Return the time of all CPUs since boot, and what was stolen of it [ticks]."""
    line = Path("/proc/stat").read_text().partition("\n")[0]
    ticks = [float(word) for word in line.split()[1:9]]
    return sum(ticks), ticks[7]


@contextlib.contextmanager
def _programs(
    running: Up, condition: TrialCondition
) -> Iterator[Callable[[float], None]]:
    """Yield what starts programs that are due at a share of the run; end them all."""
    left = sorted(condition.programs, reverse=True)
    started: list[subprocess.Popen[bytes]] = []

    def start(share: float) -> None:
        while left and left[-1][0] <= share:
            _, computer, cpu = left.pop()
            emulated = running.emulated[computer]
            cores = cpu * emulated.limits.quota
            started.append(emulated.popen(background_load(cores)))

    try:
        yield start
    finally:
        for program in started:
            program.kill()
            program.wait()


def _watched(
    running: Up,
    task: str,
    condition: TrialCondition,
    placed: TrialResult,
    seconds: float,
    check: Check,
) -> TrialResult:
    live, computers, world = (
        running.started.live,
        running.started.computers,
        running.started.world,
    )
    seen, moves, where = LastSeen(), 0, live.placement()
    computers.begin()
    waited = world.waited() if world is not None else 0.0
    live.agents.on_status = seen.record_status
    begin, began = live.agents.statuses(), time.monotonic()
    seen.record(begin)
    ticks, stolen = _cpu_times()
    with _programs(running, condition) as start_programs:
        while (now := time.monotonic() - began) < seconds:
            check()
            start_programs(now / seconds)
            if running.wait(min(_LOOK_EVERY, seconds - now)):
                raise RunError("the robot was stopped")
            if world is not None and world.has_ended():
                raise RunError(f"the simulated world ended after {now:.1f} s")
            computers.poll()
            places = live.placement()
            moves += sum(where.get(name, at) != at for name, at in places.items())
            where = places
            if running.tasks.show(task).state in OVER:
                break
    now = time.monotonic() - began
    later, stolen_later = _cpu_times()
    stolen = (stolen_later - stolen) / max(1.0, later - ticks)
    waited = world.waited() - waited if world is not None else 0.0
    end = live.agents.statuses()
    final = seen.merged(end)
    invalid = computers.end()
    if not invalid and waited > _TOLERATED * now:
        invalid = f"the simulated world waited {waited:.1f} s for a CPU of this machine"
    if not invalid and stolen > _STOLEN:
        invalid = f"a hypervisor took {stolen:.1%} of this machine's CPU"
    said = dict(world.result()) if world is not None else {}
    return replace(
        placed,
        invalid=invalid,
        seconds=now,
        functions=said.get("functions", {}),
        world={name: said[name] for name in said.keys() - _BULKY},
        chains=_chains(live.robot, placed.placement, final),
        timers=_timers(final),
        cpu_share=cpu_shares(live.robot, begin, end, computers.faster),
        moves=moves,
        world_waited=waited,
        stolen=stolen,
    )


def declared_chains(robot: Robot, placement: Collection[str]) -> Iterator[str]:
    """Yield the chains that count: all but those of alternatives that do not run.

    A chain of a function that was suspended counts.
    """
    served = {
        each.function
        for each in robot.architectures
        if all(component.name in placement for component in each.components)
    }
    replaced = {
        component.name
        for each in robot.architectures
        if each.function in served
        for component in each.components
        if component.name not in placement
    }
    for chain in robot.chains:
        if not replaced.intersection(chain.through):
            yield chain.name


def _chains(
    robot: Robot, placement: Collection[str], statuses: Statuses
) -> dict[str, Missed]:
    reports = {each.name: each for each in chain_reports(robot, statuses)}
    return {
        name: Missed(
            of=report.age.count,
            missed=report.missed,
            median=report.age.median if report.age.count else None,
            p99=report.age.p99 if report.age.count else None,
        )
        if (report := reports.get(name))
        else Missed(of=0, missed=0)
        for name in declared_chains(robot, placement)
    }


def _timers(statuses: Statuses) -> dict[str, Missed]:
    return {
        f"{component.name}.{timer.name}": Missed(of=timer.releases, missed=timer.missed)
        for component in components_of(statuses)
        for timer in component.timers
        if timer.deadline is not None
    }
