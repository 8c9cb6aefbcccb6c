"""Calibrates a robot: the speeds of its computers and the costs of its connectors."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from pathlib import Path

import msgspec
from msgspec import Struct

from poise.errors import RunError, UsageError
from poise.estimate.profile import KindCosts
from poise.estimate.profile import file as profile_file
from poise.manage.journal import Journal
from poise.manage.observe.recording import Recording
from poise.model.robot import Robot
from poise.session.calibration.costs import costs_of
from poise.session.calibration.robots import pairs, yardsticks
from poise.session.profiles import check_keepable, read_profile, store_of
from poise.session.say import Check, nothing
from poise.session.start import Sampling, Started, started
from poise.wire.records.deployment import AgentStatus, Summary

_WARM_UP = 1.0
_STEP = 0.2
_MOST_WAITING = 0.1
"""A real computer is busy when a component waits for this share of its time."""


class ComputerSpeed(Struct, frozen=True):
    """The speed of a computer.

    Parameters
    ----------
    loops
        Work done per second of CPU time [1/s].
    speed
        Relative to the reference computer; None: it is emulated on this machine.
    """

    loops: float
    speed: float | None


class Calibration(Struct, frozen=True, kw_only=True):
    """The result of a calibration.

    Parameters
    ----------
    reference
        The computer that `speed` refers to.
    computers
        Computer -> its speed.
    costs
        Kind of connector (``direct``, ``local``, ``remote``) -> CPU time of each end.
    busy
        Why the result is not believed, one sentence each; empty: it is.
    kept
        Whether the costs were written to the store, and to the profile if there is one.
    """

    reference: str
    computers: Mapping[str, ComputerSpeed]
    costs: Mapping[str, KindCosts]
    busy: tuple[str, ...] = ()
    kept: bool = False


def calibrate(
    robot: Robot,
    *,
    reference: str | None = None,
    seconds: float = 8.0,
    force: bool = False,
    check: Check = nothing,
) -> Calibration:
    """Measure how fast the robot's computers are, and what its connectors cost.

    Parameters
    ----------
    reference
        The computer that speeds are relative to; None: the first.
    seconds
        Duration of each of the two measurements [s].
    force
        Whether to keep the result of a busy machine, too.
    check
        Called several times a second; may raise to end the measurement.

    Raises
    ------
    UsageError
        There is no such computer, or the result could not be written.
    RunError
        The computers could not be measured.
    """
    names = [c.name for c in robot.computers]
    chosen = reference or names[0]
    if chosen not in names:
        raise UsageError(f"--reference {chosen}: the computers are {', '.join(names)}")
    check_keepable(robot)
    computers, busy = _speeds(robot, chosen, seconds, check)
    costs, more = _costs(robot, seconds, check)
    doubts = dict.fromkeys(doubt for doubt in (*busy, more) if doubt)
    is_kept = force or not doubts
    if is_kept:
        _keep(robot, costs)
    return Calibration(
        reference=chosen,
        computers=computers,
        costs=costs,
        busy=tuple(doubts),
        kept=is_kept,
    )


def _keep(robot: Robot, costs: Mapping[str, KindCosts]) -> None:
    """Write the costs to the store, from which later profiles take them, and now."""
    with store_of(robot) as store:
        store.add_costs(robot.name, costs)
    profile = read_profile(robot)
    if profile is not None:
        path = Path(robot.folder) / robot.profile
        calibrated = msgspec.structs.replace(profile, costs=costs)
        path.write_text(profile_file.to_text(calibrated), "utf-8")


def _speeds(
    robot: Robot, reference: str, seconds: float, check: Check
) -> tuple[dict[str, ComputerSpeed], list[str]]:
    """Return the speeds, and why they are not believed."""
    bare, placement = yardsticks(robot)
    journal = Journal(":memory:")
    with started(bare, placement, journal, _silent, check=check) as up:
        _watch(up, _WARM_UP)
        up.computers.begin(strictly=True)
        _watch(up, seconds)
        busy = [up.computers.end()]
        measured = _measures(up.run.agents.statuses().values())
    if reference not in measured:
        raise RunError(f"'{reference}' was too busy to be measured; try again")
    unit = measured[reference]["score"].median / robot.computer(reference).speed
    speeds = {}
    for computer in robot.computers:
        found = measured.get(computer.name, {})
        loops = found["score"].median if found else 0.0
        speeds[computer.name] = ComputerSpeed(
            loops, loops / unit if computer.address else None
        )
        if computer.address:
            busy.append(_waiting(computer.name, found))
    return speeds, busy


def _measures(
    statuses: Iterable[AgentStatus],
) -> dict[str, Mapping[str, Summary]]:
    """Return computer -> the measures of its yardstick, if it has some."""
    return {
        status.computer: component.measures
        for status in statuses
        for container in status.containers
        for component in container.components
        if "score" in component.measures
    }


def _waiting(computer: str, measures: Mapping[str, Summary]) -> str:
    """Return why a real computer is too busy; empty: it is not."""
    if not measures:
        return f"computer '{computer}' was too busy to be measured"
    waited = measures["waited"].mean
    if waited <= _MOST_WAITING:
        return ""
    return (
        f"computer '{computer}' was too busy: a component that wanted to run waited "
        f"for {waited:.0%} of the time"
    )


def _costs(
    robot: Robot, seconds: float, check: Check
) -> tuple[dict[str, KindCosts], str]:
    """Return the costs of connectors on the first and last computer, and a doubt."""
    bare, placement = pairs(robot, robot.computers[0].name, robot.computers[-1].name)
    recording = Recording()
    with started(
        bare, placement, Journal(":memory:"), _silent, Sampling(recording.add), check
    ) as up:
        _watch(up, _WARM_UP)
        # the ends of a connector wait for each other: only too slow a computer is busy
        up.computers.begin()
        recording.take()
        _watch(up, seconds)
        samples = recording.take()
        busy = up.computers.end()
    # the CPU time of an emulated computer is this machine's
    speeds = {c.name: c.speed if c.address else 1.0 for c in robot.computers}
    return costs_of(samples, speeds), busy


def _watch(up: Started, seconds: float) -> None:
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        up.run.watch(min(left, _STEP))
        up.computers.look()


def _silent(_: str) -> None:
    """Say nothing."""
