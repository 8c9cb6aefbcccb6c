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

from poise.cli.calibration_robots import EMPTY, PAIRS, SIZES, Pair, pairs, yardsticks
from poise.cli.launch import Up, Watching, checked, running
from poise.cli.options import parse_option
from poise.cli.profiles import read_profile
from poise.errors import RunError, UsageError
from poise.estimate import profile_file
from poise.estimate.profile import Costs
from poise.manage.journal import Journal
from poise.manage.recording import Recording
from poise.model.robot import Robot
from poise.units import SECONDS
from poise.wire.samples import AgentSample, ContainerSample

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
    goes into the profile, where the overhead of being apart is derived from it.

    Example: poise calibrate robot.yaml
    """
    robot = checked(file)
    seconds = parse_option("--for", for_, SECONDS)
    console = Console(highlight=False)
    console.print(_speeds(robot, reference or robot.computers[0].name, seconds))
    costs = _costs(robot, seconds)
    console.print(_cost_table(costs))
    profile = read_profile(robot)
    if profile is None:
        console.print("not kept: there is no profile yet; `poise profile` makes it")
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
    with running(bare, placement, Journal(":memory:"), _silent) as up:
        _watch(up, _WARM_UP + seconds)
        scores = {
            computer: component.measures["score"].median
            for computer, status in up.run.fleet.statuses().items()
            for container in status.containers
            for component in container.components
            if "score" in component.measures
        }
    if reference not in scores:
        raise RunError(f"'{reference}' was too busy to be measured; try again")
    table = Table("computer", "loops per CPU second", "speed measured", "in the file")
    unit = scores[reference] / robot.computer(reference).speed
    for computer in robot.computers:
        score = scores.get(computer.name, 0.0)
        emulated = computer.address is None
        measured = "emulated" if emulated else f"{score / unit:.2f}"
        table.add_row(computer.name, f"{score:.0f}", measured, f"{computer.speed:g}")
    return table


def _costs(robot: Robot, seconds: float) -> dict[str, Costs]:
    """Return what connectors cost beyond direct ones; remote with two computers."""
    here, there = robot.computers[0].name, robot.computers[-1].name
    bare, placement = pairs(robot, here, there)
    recording = Recording()
    with running(
        bare, placement, Journal(":memory:"), _silent, Watching(recording.add)
    ) as up:
        _watch(up, _WARM_UP)
        recording.take()
        _watch(up, seconds)
        found = _per_use(recording.take())
    direct = _fitted(found, "direct")
    kinds = ["local"] + (["remote"] if here != there else [])
    return {kind: _beyond(_fitted(found, kind), direct) for kind in kinds}


def _per_use(samples: list[AgentSample]) -> dict[Pair, float]:
    """Return the CPU time of one call or message of each pair, both ends [s]."""
    first: dict[str, ContainerSample] = {}
    last: dict[str, ContainerSample] = {}
    for sample in samples:
        for container in sample.containers:
            first.setdefault(container.name, container)
            last[container.name] = container
    used = {n: last[n].cpu - first[n].cpu for n in last}
    idle = used.get(EMPTY, 0.0)
    found = {}
    for pair in PAIRS:
        source = pair.containers[0]
        if source not in last:
            raise RunError(f"container '{source}' told nothing; try again")
        uses = _uses(last[source]) - _uses(first[source])
        spent = sum(used[name] - idle for name in pair.containers)
        found[pair] = max(0.0, spent) / max(uses, 1)
    return found


def _uses(sample: ContainerSample) -> int:
    return sum(each.calls + each.messages for each in sample.connectors)


def _fitted(found: Mapping[Pair, float], kind: str) -> Costs:
    """Return the line through small and large; both directions' bytes are alike."""
    small, large = SIZES
    calls = [found[Pair(kind, "call", size)] for size in SIZES]
    messages = [found[Pair(kind, "message", size)] for size in SIZES]
    slopes = [(b - a) / (large - small) for a, b in (calls, messages)]
    byte = max(0.0, sum(slopes) / len(slopes))
    return Costs(
        call=max(0.0, calls[0] - small * byte),
        message=max(0.0, messages[0] - small * byte),
        byte=byte,
    )


def _beyond(costs: Costs, direct: Costs) -> Costs:
    return Costs(
        call=max(0.0, costs.call - direct.call),
        message=max(0.0, costs.message - direct.message),
        byte=max(0.0, costs.byte - direct.byte),
    )


def _cost_table(costs: Mapping[str, Costs]) -> Table:
    table = Table("connector", "per call", "per message", "per kB")
    for kind, cost in costs.items():
        table.add_row(
            kind,
            f"{cost.call * 1e6:.0f} µs",
            f"{cost.message * 1e6:.0f} µs",
            f"{cost.byte * 1e9:.2f} µs",
        )
    return table


def _watch(up: Up, seconds: float) -> None:
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        up.run.watch(left)


def _silent(_: str) -> None:
    """Say nothing."""
