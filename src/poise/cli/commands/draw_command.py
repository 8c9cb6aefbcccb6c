"""`poise draw`: a robot as UML diagrams."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from poise.cli.options import RobotFile, RobotTask, busy
from poise.errors import RobotError, UsageError
from poise.model import load
from poise.model.robot import Robot
from poise.session.diagrams.draw import FORMATS, What, draw
from poise.session.placing.placement import place
from poise.session.profiling.stored_profiles import profiled
from poise.session.render.printable import console_to
from poise.session.running_robots.running import Running

_RUNNING = "running"
_ON_STDOUT = "-"


def draw_command(
    file: RobotFile,
    what: Annotated[
        What | None, typer.Option(help="Else as the placements ask for.")
    ] = None,
    task: RobotTask = None,
    placement: Annotated[
        str | None,
        typer.Option(
            help="Where components are: running, auto, static, another method of "
            "`poise plan`, or a file with `component: computer`."
        ),
    ] = None,
    compare: Annotated[
        str | None,
        typer.Option(help="Placements side by side, before and after: static,auto."),
    ] = None,
    output: Annotated[
        str | None,
        typer.Option(
            "--output",
            "-o",
            help=f"The file; it ends in {', '.join(FORMATS)}. '-': Mermaid on stdout.",
        ),
    ] = None,
) -> None:
    """Draw a robot as a UML diagram: its components, where they run, or how they move.

    Without --placement and --compare it is a component diagram; with them, a deployment
    diagram; with --what transition, a sequence diagram of the way from the first
    placement to the second.

    Examples
    --------
    poise draw robot.yaml -o robot.svg

    poise draw robot.yaml --placement running -o now.svg

    poise draw robot.yaml --compare static,auto

    poise draw robot.yaml --what transition --compare static,auto -o -
    """
    if placement is not None and compare is not None:
        raise UsageError("--placement and --compare together: --compare names them all")
    names = [n.strip() for n in (compare or placement or "").split(",") if n.strip()]
    chosen: What = what or ("deployment" if names else "components")
    if chosen != "components" and not names:
        names = ["static", "auto"] if chosen == "transition" else ["auto"]
    console = console_to(stderr=True)
    found = profiled(load(file))
    for sentence in found.says:
        console.print(sentence)
    robot = found.robot
    drawing = draw(robot, chosen, _placements(robot, task, names), task=task)
    if output == _ON_STDOUT:
        sys.stdout.write(drawing.text())
        return
    path = Path(output or f"{robot.name}-{chosen}.svg")
    with busy("drawing"):
        drawing.save(path)
    console.print(f"wrote {path}")


def _placements(
    robot: Robot, task: str | None, names: list[str]
) -> Mapping[str, Mapping[str, str]]:
    found: dict[str, Mapping[str, str]] = {}
    for name in names:
        if name == _RUNNING:
            found[name] = Running(robot.name).status().placement
            continue
        placed = place(robot, task, method=name, at_once=True)
        if not placed.where:
            raise RobotError(f"'{name}' gives no placement: {placed.reason}")
        found[name] = placed.where
    return found
