"""Robot files in other forms: `poise draw`, `poise ros2 import` and `export`."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated

import typer

from poise.cli.options import RobotFile, Set, arguments_of, busy, in_file, parse_option
from poise.cli.plan_command import computer_of
from poise.errors import RobotError, UsageError
from poise.model.hardware import Computer
from poise.model.loading import load
from poise.model.robot import Robot
from poise.session.arguments import check_name
from poise.session.diagrams.draw import FORMATS, What, draw
from poise.session.folders import make_folder, to_write, write_whole
from poise.session.placing.placement import place
from poise.session.profiling.stored_profiles import profiled
from poise.session.render.printable import console_to
from poise.session.robot_file import check, with_code
from poise.session.running_robots.running import Running
from poise.units import SECONDS, format_bytes

_RUNNING = "running"
_ON_STDOUT = "-"
_WHERE = (
    "Where components are: running, auto, static, another method of `poise plan`, or a "
    "file with `component: computer`."
)

_TaskOrAll = Annotated[
    str | None,
    typer.Option(
        "--task",
        help="The task. Default: all functions.",
        autocompletion=in_file("tasks"),
    ),
]


def draw_command(
    file: RobotFile,
    what: Annotated[
        What | None,
        typer.Option(help="What to draw. Default: what the placements ask for."),
    ] = None,
    task: _TaskOrAll = None,
    placement: Annotated[str | None, typer.Option(help=_WHERE)] = None,
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
    set_: Set = None,
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
        raise UsageError(
            "--placement and --compare exclude each other: --compare lists placements"
        )
    names = [n.strip() for n in (compare or placement or "").split(",") if n.strip()]
    if not names and {compare, placement} != {None}:
        given = compare or placement or ""
        raise UsageError(f"{given!r} names no placement, as static,auto")
    chosen: What = what or ("deployment" if names else "components")
    if chosen != "components" and not names:
        names = ["static", "auto"] if chosen == "transition" else ["auto"]
    console = console_to(stderr=True)
    robot = profiled(load(file, arguments_of(set_)), console.say)
    path = Path(output or f"{robot.name}-{chosen}.svg")
    if output != _ON_STDOUT:
        to_write(path)
    drawing = draw(robot, chosen, _placements(robot, task, names), task=task)
    if output == _ON_STDOUT:
        sys.stdout.write(drawing.text())
        return
    with busy("drawing"):
        drawing.save(path)
    console.say(f"wrote {path}")


def _placements(
    robot: Robot, task: str | None, names: list[str]
) -> Mapping[str, Mapping[str, str]]:
    placements: dict[str, Mapping[str, str]] = {}
    if {*names} - {_RUNNING}:
        robot = with_code(robot)  # deadlines of timers stand there
    for name in names:
        if name == _RUNNING:
            placements[name] = Running(robot.name).status().placement
            continue
        placed = place(robot, task, method=name, at_once=True)
        if not placed.where:
            raise RobotError(f"'{name}' gives no placement: {placed.reason}")
        placements[name] = placed.where
    return placements


def ros2_command() -> None:
    """Write ROS 2 nodes as a robot file, or a robot file's nodes as launch files.

    Examples
    --------
    poise ros2 import --for 30s -o robot.yaml

    poise ros2 export robot.yaml --task work -o launch
    """
    raise UsageError("which one: poise ros2 import, or poise ros2 export?")


def import_command(
    for_: Annotated[
        str, typer.Option("--for", help="How long to watch; longer is more accurate.")
    ] = "30s",
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The robot file to write.")
    ] = Path("robot.yaml"),
    computer: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME:cpu=2,memory=4GiB",
            help="A computer for the robot; main stands for this one. Repeatable.",
        ),
    ] = None,
    name: Annotated[str, typer.Option(help="The robot's name.")] = "ros2",
) -> None:
    """Watch a running ROS 2 graph, and write it as a robot file.

    Measures what nodes send, and what CPU and memory their processes take. Reads from
    the command lines how to start them again. Changes nothing: it subscribes without
    asking for lost messages, and to big topics only at times. Run it beside the nodes,
    with their environment, in one that has rclpy, too.

    Examples
    --------
    poise ros2 import --for 30s -o robot.yaml

    poise ros2 import --computer vision:cpu=4,memory=8GiB
    """
    from poise.session.ros2_import.import_robot import import_robot

    seconds = parse_option("--for", for_, SECONDS)
    if seconds <= 0:
        raise UsageError(f"--for {for_}: must be longer than 0 s")
    if output.exists():
        raise UsageError(f"{output} exists: remove it, or name another file with -o")
    if not output.absolute().parent.is_dir():
        raise UsageError(f"--output {output}: there is no folder for it")
    check_name(name, "a name", "--name")
    computers = _keys(computer_of(each, "--computer") for each in computer or ())
    sys.stderr.write(f"watching ROS 2 for {seconds:g} s\n")
    imported = import_robot(
        seconds, name=name, folder=output.absolute().parent, computers=computers
    )
    write_whole(output, imported.text)
    for line in imported.summary():
        sys.stderr.write(f"{line}\n")
    sys.stderr.write(f"wrote {output}; next: poise plan {output}\n")
    problems = check(output)
    for problem in problems:
        sys.stderr.write(f"{problem}\n")
    if problems:
        raise typer.Exit(1)


def export_command(
    file: RobotFile,
    task: _TaskOrAll = None,
    placement: Annotated[str, typer.Option(help=_WHERE)] = "auto",
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The folder for the launch files.")
    ] = Path(),
    set_: Set = None,
) -> None:
    """Write launch files of ROS 2 that start a robot's nodes, one for each computer.

    COMPUTER.launch.py starts each node as Poise would, and other executables, too.
    Components of Poise and bridges are in none; they are named.

    Examples
    --------
    poise ros2 export robot.yaml --task work -o launch
    """
    from poise.session.ros2_export import launch_files

    robot = load(file, arguments_of(set_))
    where = _placements(robot, task, [placement])[placement]
    folder = os.path.relpath(robot.folder, output)
    exported = launch_files(robot, where, folder)
    paths = {
        output / f"{computer}.launch.py": text
        for computer, text in exported.texts.items()
    }
    if there := [str(path) for path in paths if path.exists()]:
        raise UsageError(
            f"{', '.join(there)} exists: remove it, or name another folder with -o"
        )
    make_folder(output)
    for path in paths:
        to_write(path)
    for path, text in paths.items():
        write_whole(path, text)
        sys.stdout.write(f"{path}\n")
    for name in exported.left_out:
        sys.stderr.write(f"left out: '{name}', which only Poise can start\n")


def _keys(computers: Iterable[Computer]) -> dict[str, dict[str, str | float]]:
    """Return computers as a robot file has them; UsageError: it has none such."""
    keys: dict[str, dict[str, str | float]] = {}
    for computer in computers:
        name, has = computer.name, computer.capacity
        check_name(name, "a name", "--computer")
        if name in keys:
            raise UsageError(f"--computer {name} is there twice: name it once")
        if has.keys() != {"cpu", "memory"} or not all(has.values()):
            raise UsageError(
                f"--computer {name}: say its cpu and its memory, as in "
                f"{name}:cpu=2,memory=4GiB"
            )
        keys[name] = {"cpu": has["cpu"], "memory": format_bytes(has["memory"])}
    return keys
