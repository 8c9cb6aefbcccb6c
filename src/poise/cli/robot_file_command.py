"""Robot files: `poise check`, `policy`, `repository`, `draw` and `ros2 import`."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import typer
from msgspec import structs
from rich.console import RenderableType
from rich.markup import escape
from rich.table import Table

from poise.cli.options import (
    AsJson,
    RobotFile,
    RobotTask,
    Set,
    arguments_of,
    busy,
    in_file,
    parse_option,
    show,
)
from poise.cli.plan_command import computer_of
from poise.errors import FileProblem, RobotError, UsageError, unknown
from poise.estimate.success_rates import beliefs_about, forget
from poise.model.check.allowed_computers import notes_of
from poise.model.hardware import Computer
from poise.model.load import load
from poise.model.policy import Policy, policies_of
from poise.model.robot import Robot
from poise.session.diagrams.draw import FORMATS, What, draw
from poise.session.placing.first_phase import Described, Listed, listed
from poise.session.placing.placement import place
from poise.session.profiling.stored_profiles import profiled
from poise.session.recorded_run import PolicyEvent, test_policies
from poise.session.render.printable import console_to
from poise.session.render.tables import table
from poise.session.robot_file import check
from poise.session.running_robots.running import Running
from poise.units import SECONDS, counted, format_bytes, format_seconds


def check_command(
    file: Annotated[
        Path | None, typer.Argument(help="The robot file.", envvar="POISE_ROBOT")
    ] = None,
    set_: Set = None,
    as_json: AsJson = False,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON Schema of robot files.")
    ] = False,
) -> None:
    """Check a robot file and the code that it names.

    It reports every problem as file:line:column and message. The exit code is 0 when
    there is none.

    Example: poise check robot.yaml
    """
    if schema:
        _print_schema()
        return
    if file is None:
        raise UsageError("give a robot file, as in `poise check robot.yaml`")
    with busy("checking"):
        arguments = arguments_of(set_)
        problems = check(file, arguments)
    notes = () if problems else notes_of(load(file, arguments))
    if as_json:
        _print_json(problems, notes)
    else:
        _print_text(file, problems, notes)
    if problems:
        raise typer.Exit(1)


def _print_schema() -> None:
    from poise.model.schema import schema_text

    sys.stdout.write(schema_text())


def _print_json(problems: tuple[FileProblem, ...], notes: tuple[str, ...]) -> None:
    report = {
        "ok": not problems,
        "problems": msgspec.to_builtins(problems),
        "notes": notes,
    }
    sys.stdout.write(json.dumps(report, indent=2) + "\n")


def _print_text(
    path: Path, problems: tuple[FileProblem, ...], notes: tuple[str, ...]
) -> None:
    if not problems:
        sys.stdout.write("\n".join((f"{path}: no problems", *notes, "")))
        return
    for problem in problems:
        sys.stderr.write(f"{problem}\n")
    sys.stderr.write(f"{path}: {counted(len(problems), 'problem')}\n")


def policy_command(
    what: Annotated[
        Literal["list", "test"],
        typer.Argument(
            help="list: what is done, and when; test: what would have been done."
        ),
    ],
    file: RobotFile,
    recording: Annotated[
        Path | None, typer.Option(help="For test: a file of `poise up --record`.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Show the policies of a robot, those that Poise ships and its own, or test them.

    A test replays a recording of `poise up --record FILE`, and prints what the policies
    would have done when. Nothing is done.

    Examples
    --------
    poise policy list robot.yaml
    poise policy test robot.yaml --recording run.mcap
    """
    robot, console = load(file), console_to(stderr=as_json)
    if what == "list":
        policies = policies_of(robot.policies)
        show(policies, [_policy_table(policies)], as_json=as_json)
        return
    if recording is None:
        raise UsageError("give a recording: --recording FILE, of `poise up --record`")
    events = test_policies(
        robot, recording, say=lambda text: console.print(text, style="yellow")
    )
    show(events, _event_parts(events), as_json=as_json)


def _policy_table(policies: tuple[Policy, ...]) -> Table:
    rows = table("policy", "for each", "when", "lasts", "do", "cool down", folds=2)
    for policy in policies:
        rows.add_row(
            policy.name,
            policy.for_each or "",
            policy.when or policy.call or "",
            format_seconds(policy.lasts or 0.0),
            "off" if policy.off else policy.do or "",
            format_seconds(policy.cool_down or 0.0),
        )
    return rows


def _event_parts(events: tuple[PolicyEvent, ...]) -> Iterator[RenderableType]:
    rows = table("at [s]", "policy", "do", "what was seen", folds=3)
    for event in events:
        rows.add_row(f"{event.at:.1f}", event.policy, event.do or "", event.what)
    yield rows
    if not events:
        yield "the policies would have done nothing"


AnyFile = Annotated[
    Path | None,
    typer.Argument(
        envvar="POISE_ROBOT",
        help="The robot file; without it, only installed packages are searched.",
    ),
]
Name = Annotated[str, typer.Argument(help="The architecture.")]


def list_command(file: AnyFile = None, as_json: AsJson = False) -> None:
    """List the architectures that a robot may choose from, by function.

    They are from its file, from the folders of its `repository`, and from installed
    packages.

    Examples
    --------
    poise repository list robot.yaml
    """
    rows = listed(file)
    none = "no installed package has the entry point poise.architectures"
    show(rows, [_architecture_table(rows) if rows else none], as_json=as_json)


def show_command(name: Name, file: AnyFile = None, as_json: AsJson = False) -> None:
    """Show an architecture, and how often actions succeeded with it.

    Examples
    --------
    poise repository show laser_navigator robot.yaml
    """
    rows = listed(file)
    row = next((row for row in rows if row.architecture == name), None)
    if row is None:
        names = [row.architecture for row in rows]
        raise UsageError(unknown("architecture", name, names))
    beliefs = [] if file is None or row.unused else beliefs_about(load(file), name)
    described = Described(**structs.asdict(row), learned=tuple(beliefs))
    show(described, _architecture_parts(described), as_json=as_json)


def reset_command(name: Name, file: RobotFile) -> None:
    """Forget how often actions succeeded with an architecture.

    Examples
    --------
    poise repository reset laser_navigator robot.yaml
    """
    count = forget(load(file), name)
    console_to().print(f"{counted(count, 'outcome')} of '{name}' forgotten")


def _architecture_table(rows: list[Listed]) -> Table:
    shown = table("function", "architecture", "quality", "hash", "from", folds=4)
    for row in rows:
        source = f"{row.where} ({row.package})" if row.package else row.where
        unused = f"\nnot used: {row.unused}" if row.unused else ""
        quality = f"{row.quality:g}"
        where = escape(source + unused)
        shown.add_row(row.function, row.architecture, quality, row.hash, where)
    return shown


def _architecture_parts(row: Described) -> Iterator[RenderableType]:
    what = f"{row.architecture} provides {row.function}"
    for sentence in (
        f"{what}, quality {row.quality:g}, {row.layer} layer",
        f"from {row.where}" + (f", package {row.package}" if row.package else ""),
        f"hash {row.hash}",
        f"components: {', '.join(row.components)}",
        *((f"not used: {row.unused}",) if row.unused else ()),
    ):
        yield escape(sentence)
    if not row.learned:
        yield "nothing has been learned yet"
        return
    shown = table("action", "conditions", "success", "of", "hash", folds=1)
    for belief in row.learned:
        shown.add_row(
            belief.action,
            str(belief.conditions),
            f"{belief.mean:.0%} ± {belief.deviation:.0%}",
            f"{belief.done + belief.failed:.0f}",
            belief.hash if belief.is_present else f"{belief.hash}, before",
        )
    yield shown


repository_command = list_command


_RUNNING = "running"
_ON_STDOUT = "-"


def draw_command(
    file: RobotFile,
    what: Annotated[
        What | None,
        typer.Option(help="What to draw. Default: what the placements ask for."),
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
        raise UsageError("--placement and --compare together: --compare names them all")
    names = [n.strip() for n in (compare or placement or "").split(",") if n.strip()]
    chosen: What = what or ("deployment" if names else "components")
    if chosen != "components" and not names:
        names = ["static", "auto"] if chosen == "transition" else ["auto"]
    console = console_to(stderr=True)
    measured = profiled(load(file, arguments_of(set_)))
    for sentence in measured.says:
        console.print(sentence)
    robot = measured.robot
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
    placements: dict[str, Mapping[str, str]] = {}
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
    imported = import_robot(
        seconds, name=name, folder=output.absolute().parent, computers=computers
    )
    output.write_text(imported.text, encoding="utf-8")
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
    task: Annotated[
        str | None,
        typer.Option(
            help="The task. Default: all functions.", autocompletion=in_file("tasks")
        ),
    ] = None,
    placement: Annotated[
        str,
        typer.Option(
            help="Where components are: running, auto, static, another method of "
            "`poise plan`, or a file with `component: computer`."
        ),
    ] = "auto",
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
    output.mkdir(parents=True, exist_ok=True)
    for path, text in paths.items():
        path.write_text(text, encoding="utf-8")
        sys.stdout.write(f"{path}\n")
    for name in exported.left_out:
        sys.stderr.write(f"left out: '{name}', which only Poise can start\n")


def _keys(computers: Iterable[Computer]) -> dict[str, dict[str, str | float]]:
    """Return computers as a robot file has them."""
    return {
        computer.name: {
            "cpu": computer.capacity.get("cpu", 0.0),
            "memory": format_bytes(computer.capacity.get("memory", 0)),
        }
        for computer in computers
    }
