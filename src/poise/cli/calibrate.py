"""`poise calibrate`: measure computers' speeds and what connectors cost."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from rich.table import Table

from poise.cli.options import parse_option
from poise.errors import RunError, UsageError
from poise.estimate.profile import KindCosts
from poise.estimate.profile import file as profile_file
from poise.manage.journal import Journal
from poise.manage.observe.recording import Recording
from poise.model.robot import Computer, Robot
from poise.session.calibration_costs import costs_of
from poise.session.calibration_robots import pairs, yardsticks
from poise.session.profiles import check_keepable, read_profile, store_of
from poise.session.render.tables import table
from poise.session.robot_file import load_bare
from poise.session.start import Sampling, Started, started
from poise.units import SECONDS

_WARM_UP = 1.0


def calibrate_command(
    file: Annotated[Path, typer.Argument(help="The robot file.")],
    reference: Annotated[
        str | None,
        typer.Option(help="The computer whose speed counts; else the first."),
    ] = None,
    for_: Annotated[
        str, typer.Option("--for", help="How long to measure each time.")
    ] = "8s",
) -> None:
    """Measure how fast the robot's computers are, and what its connectors cost.

    Speeds are relative to the reference computer's, for `speed` in the robot file. An
    emulated computer is as fast as this machine while it runs. What connectors cost
    goes into the profile: the planner's overhead of being apart is derived from it.

    Example: poise calibrate robot.yaml
    """
    robot = load_bare(file)
    check_keepable(robot)
    seconds = parse_option("--for", for_, SECONDS)
    console = Console(highlight=False)
    console.print(_speeds(robot, reference or robot.computers[0].name, seconds))
    costs = _costs(robot, seconds)
    console.print(_cost_table(costs))
    with store_of(robot) as store:
        store.add_costs(robot.name, costs)
    profile = read_profile(robot)
    if profile is None:
        console.print("kept in the store: `poise profile` takes it from there")
        return
    path = Path(robot.folder) / robot.profile
    path.write_text(
        profile_file.to_text(msgspec.structs.replace(profile, costs=costs)), "utf-8"
    )
    console.print(f"written to {path}")


def _speeds(robot: Robot, reference: str, seconds: float) -> Table:
    if reference not in {c.name for c in robot.computers}:
        known = ", ".join(c.name for c in robot.computers)
        raise UsageError(f"--reference {reference}: the computers are {known}")
    bare, placement = yardsticks(robot)
    with started(bare, placement, Journal(":memory:"), _silent) as up:
        _watch(up, _WARM_UP + seconds)
        scores = {
            computer: component.measures["score"].median
            for computer, status in up.run.agents.statuses().items()
            for container in status.containers
            for component in container.components
            if "score" in component.measures
        }
    if reference not in scores:
        raise RunError(f"'{reference}' was too busy to be measured; try again")
    rows = table("computer", "loops per CPU second", "speed measured", "in the file")
    unit = scores[reference] / robot.computer(reference).speed
    for computer in robot.computers:
        score = scores.get(computer.name, 0.0)
        emulated = computer.address is None
        measured = "emulated" if emulated else f"{score / unit:.2f}"
        rows.add_row(computer.name, f"{score:.0f}", measured, f"{computer.speed:g}")
    return rows


def _costs(robot: Robot, seconds: float) -> dict[str, KindCosts]:
    """Return what connectors cost on the robot's first and last computer."""
    here, there = robot.computers[0], robot.computers[-1]
    bare, placement = pairs(robot, here.name, there.name)
    recording = Recording()
    with started(
        bare, placement, Journal(":memory:"), _silent, Sampling(recording.add)
    ) as up:
        _watch(up, _WARM_UP)
        recording.take()
        _watch(up, seconds)
        samples = recording.take()
    return costs_of(samples, {c.name: _speed(c) for c in robot.computers})


def _speed(computer: Computer) -> float:
    """Return what turns CPU time into the reference computer's."""
    return computer.speed if computer.address else 1.0


def _cost_table(costs: Mapping[str, KindCosts]) -> Table:
    rows = table("connector", "end", "per call", "per message", "per kB")
    for kind, both in costs.items():
        for end, cost in (("source", both.source), ("target", both.target)):
            if kind == "direct" and end == "target":
                continue  # in the same process as the source
            rows.add_row(
                kind,
                "both" if kind == "direct" else end,
                f"{cost.call * 1e6:.0f} µs",
                f"{cost.message * 1e6:.0f} µs",
                f"{cost.byte * 1e9:.2f} µs",
            )
    return rows


def _watch(up: Started, seconds: float) -> None:
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        up.run.watch(left)


def _silent(_: str) -> None:
    """Say nothing."""
