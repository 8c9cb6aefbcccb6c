"""`poise ros2`: what joins a robot with ROS 2."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from poise.cli.commands.plan_command import computer_of
from poise.cli.options import parse_option
from poise.errors import UsageError
from poise.model.hardware import Computer
from poise.units import SECONDS, format_bytes


def ros2_command() -> None:
    """Write ROS 2 nodes as a robot file.

    Examples
    --------
    poise ros2 import --for 30s -o robot.yaml
    """
    raise UsageError("say what: poise ros2 import")


def import_command(
    for_: Annotated[
        str, typer.Option("--for", help="How long to watch; the longer, the truer.")
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
    from poise.session.robot_file import check
    from poise.session.ros2_import.import_robot import import_robot

    seconds = parse_option("--for", for_, SECONDS)
    if seconds <= 0:
        raise UsageError(f"--for {for_}: must be longer than 0 s")
    if output.exists():
        raise UsageError(f"{output} exists: remove it, or name another file with -o")
    if not output.absolute().parent.is_dir():
        raise UsageError(f"--output {output}: there is no folder for it")
    computers = _keys(map(computer_of, computer or ()))
    sys.stderr.write(f"watching ROS 2 for {seconds:g} s\n")
    found = import_robot(
        seconds, name=name, folder=output.absolute().parent, computers=computers
    )
    output.write_text(found.text, encoding="utf-8")
    for line in found.summary():
        sys.stderr.write(f"{line}\n")
    sys.stderr.write(f"wrote {output}; next: poise plan {output}\n")
    problems = check(output)
    for problem in problems:
        sys.stderr.write(f"{problem}\n")
    if problems:
        raise typer.Exit(1)


def _keys(computers: Iterable[Computer]) -> dict[str, dict[str, str | float]]:
    """Return computers as a robot file has them."""
    return {
        each.name: {
            "cpu": each.capacity.get("cpu", 0.0),
            "memory": format_bytes(each.capacity.get("memory", 0)),
        }
        for each in computers
    }
