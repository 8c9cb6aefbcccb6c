"""Calibrates a robot: the speeds of its computers and the costs of its connectors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec
from msgspec import Struct

from poise.errors import RunError, UsageError
from poise.estimate import profiles as profile_file
from poise.estimate.profiles import KindCosts
from poise.manage.agent_connections.statuses import Statuses, located
from poise.manage.journal import Journal
from poise.manage.observe.sample_recording import Recording
from poise.model.robot import Robot
from poise.runtime.calibration import SCORES
from poise.session.callbacks import Check, nothing
from poise.session.launch.start import Sampling, started
from poise.session.profiling.connector_costs import costs_of, pairs, yardsticks
from poise.session.profiling.stored_profiles import (
    check_keepable,
    read_profile,
    steady,
    store_of,
)

_WARM_UP = 1.0
_SPREAD = 0.05
"""The quickest runs of repeated measurements differ by at most this share."""


class ComputerSpeed(Struct, frozen=True):
    """The speed of a computer.

    Parameters
    ----------
    loops
        Work done per second of CPU time, when nothing disturbs it [1/s].
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
    with steady(robot):
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
    with started(bare, placement, journal, nothing, check=check) as up:
        up.watch(_WARM_UP)
        up.watch(seconds)
        measured = _measures(up.run.agents.statuses())
    if reference not in measured:
        raise RunError(f"'{reference}' was too busy to be measured; try again")
    unit = max(measured[reference]) / robot.computer(reference).speed
    speeds, doubts = {}, []
    for computer in robot.computers:
        scores = measured.get(computer.name, ())
        loops = max(scores, default=0.0)
        speeds[computer.name] = ComputerSpeed(
            loops, loops / unit if computer.address else None
        )
        doubts.append(_doubt(computer.name, scores))
    return speeds, doubts


def _measures(statuses: Statuses) -> dict[str, tuple[float, ...]]:
    """Return computer -> the largest score of each series of its yardstick."""
    return {
        computer: tuple(component.measures[each].maximum for each in SCORES)
        for computer, component in located(statuses)
        if component.measures.keys() >= set(SCORES)
    }


def _doubt(computer: str, scores: Sequence[float]) -> str:
    """Return why a computer's speed is not believed; empty: it is."""
    if not scores:
        return f"computer '{computer}' was too busy to be measured"
    spread = max(scores) / min(scores) - 1
    if spread <= _SPREAD:
        return ""
    return (
        f"the speed of computer '{computer}' was not steady: the quickest runs of "
        f"{len(scores)} series differ by {spread:.0%}"
    )


def _costs(
    robot: Robot, seconds: float, check: Check
) -> tuple[dict[str, KindCosts], str]:
    """Return the costs of connectors on the first and last computer, and a doubt."""
    bare, placement = pairs(robot, robot.computers[0].name, robot.computers[-1].name)
    recording = Recording()
    with started(
        bare, placement, Journal(":memory:"), nothing, Sampling(recording.add), check
    ) as up:
        up.watch(_WARM_UP)
        up.computers.begin()
        recording.drain()
        up.watch(seconds)
        samples = recording.drain()
        busy = up.computers.end()
    # the CPU time of an emulated computer is this machine's
    speeds = {c.name: c.speed if c.address else 1.0 for c in robot.computers}
    return costs_of(samples, speeds), busy
