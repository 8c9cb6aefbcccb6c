"""`poise deploy`, `run`, `up` and `demo`: send code, start a robot, and watch it."""

from __future__ import annotations

import contextlib
import importlib
import sys
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Annotated, Literal

import msgspec
import typer
from msgspec.structs import replace

from poise.cli.main import Interrupts
from poise.cli.options import (
    AnyMethod,
    AsJson,
    Method,
    RobotFile,
    RobotTask,
    Set,
    arguments_of,
    positive_seconds,
    show,
    try_write,
)
from poise.cli.watch_command import check_dashboard, dashboard_beside
from poise.errors import UsageError
from poise.model.steps import Prefetch
from poise.session.deploy.deploy import deploy
from poise.session.folders import make_folder, to_write
from poise.session.launch.background_log import keep_log_small
from poise.session.launch.printer import Printer, log_printer
from poise.session.placing.placement import place
from poise.session.render.printable import console_to
from poise.session.render.run_progress import progress
from poise.session.robot_file import load, task_of
from poise.session.run import run


def run_command(
    file: RobotFile,
    task: RobotTask = None,
    placement: Method = "auto",
    for_: Annotated[
        str, typer.Option("--for", help="How long at most, such as 20s or 2 min.")
    ] = "20s",
    report: Annotated[
        Path | None,
        typer.Option(help="Folder for report.html, report.json and the journal."),
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(
            help="File for samples, and for messages between architectures.",
            callback=to_write,
        ),
    ] = None,
    adapt: Annotated[
        bool, typer.Option("--adapt", help="Change the placement as `poise up` does.")
    ] = False,
    allow_errors: Annotated[
        bool,
        typer.Option(
            "--allow-errors", help="Exit with 0 when components had errors, too."
        ),
    ] = False,
    set_: Set = None,
    as_json: AsJson = False,
) -> None:
    """Run a task on the robot's computers; without addresses they are emulated.

    Its actions run in their order. It ends when the task does, or after --for.
    Meanwhile `poise status`, `task`, `move`, `replace` and `balance` work on it.

    What --record keeps can be the `workload` on which `poise profile` measures;
    `poise recording` reads it. The exit code is 1 when a component raised or hung, a
    message was refused, a container ended, the task failed, the run is invalid, or
    not all could be recorded.

    Example: poise run robot.yaml --task fetch --for 20s
    """
    seconds = positive_seconds(for_, "a run")
    console = console_to(stderr=as_json)
    say = console.say
    with console.status("checking the robot file and its code ..."):
        robot = load(file, arguments_of(set_), say=say)
    chosen = task_of(robot, task)
    placed = place(robot, chosen, method=placement, fewer=True)
    if report is not None:
        to_write(make_folder(report) / "report.json")
    with Interrupts() as interrupts:
        with progress(console, seconds) as show:
            result = run(
                robot,
                chosen,
                seconds=seconds,
                placement=placed,
                journal=report / "journal.jsonl" if report else None,
                record=record,
                adapt=adapt,
                say=say,
                meanwhile=show,
                check=interrupts.check,
            )
        text = msgspec.json.format(msgspec.json.encode(result))
        is_kept = report is None or (
            try_write(report / "report.json", text.decode() + "\n", say)
            and try_write(report / "report.html", result.page(), say)
        )
        if as_json:
            sys.stdout.write(text.decode() + "\n")
        else:
            console.print(result)
    is_kept = is_kept and not result.unrecorded
    if result.invalid or not is_kept or (result.failed and not allow_errors):
        raise typer.Exit(1)


_POLL_EVERY = 0.2


def up_command(
    file: RobotFile,
    task: Annotated[
        list[str] | None,
        typer.Option("--task", help="A task, or several. Default: the file's first."),
    ] = None,
    placement: AnyMethod = None,
    journal: Annotated[
        Path | None,
        typer.Option(help="File for the journal, else in the user's state folder."),
    ] = None,
    metrics: Annotated[
        int | None,
        typer.Option(
            min=1, max=65535, help="TCP port for Prometheus, on this computer."
        ),
    ] = None,
    otel: Annotated[
        str | None, typer.Option(help="URL of an OpenTelemetry collector (OTLP/HTTP).")
    ] = None,
    adapt: Annotated[
        bool, typer.Option(help="Change the placement when deadlines are missed.")
    ] = True,
    prefetch: Annotated[
        bool, typer.Option(help="Prepare what the next actions need.")
    ] = True,
    take_over: Annotated[
        bool, typer.Option("--take-over", help="Replace its present manager.")
    ] = False,
    detach: Annotated[
        bool,
        typer.Option("--detach", help="Return once it is up, and leave it running."),
    ] = False,
    dashboard: Annotated[
        bool, typer.Option("--dashboard", help="Show it as a web page meanwhile.")
    ] = False,
    record: Annotated[
        Path | None,
        typer.Option(
            help="File for samples, and for the values of policies. The one before "
            "stays beside it, as NAME-before.",
            callback=to_write,
        ),
    ] = None,
    set_: Set = None,
) -> None:
    """Start a robot and keep it running until Ctrl-C or `poise stop`.

    With --detach it goes on in the background, and returns once the robot is up.

    Meanwhile `poise status`, `task`, `move`, `replace` and `balance` work on it. It
    prints each move, what its tasks do, and everything that is not as the robot file
    says.

    Examples
    --------
    poise up robot.yaml --task fetch

    poise up robot.yaml --set side=left --set speed=0.5
    """
    if dashboard:
        check_dashboard()
    with Printer() as printer, log_printer():
        say = printer.print
        # the manager, so that a robot waits for it no longer than it must
        import_the_rest = partial(importlib.import_module, "poise.session.up")
        robot = load(file, arguments_of(set_), say=say, meanwhile=import_the_rest)
        from poise.session.launch.detached import up_detached
        from poise.session.up import up

        if detach:
            with Interrupts() as interrupts:
                words = [word for word in sys.argv[1:] if word != "--detach"]
                values, check = set_ or (), interrupts.check
                up_detached(robot, file, words, say, check, arguments=values)
            if dashboard:
                say("its log says where the dashboard is")
            return
        if not prefetch:
            robot = replace(robot, prefetch=Prefetch(off=True))
        tasks = task or [task_of(robot, None)]
        if placement and len(tasks) > 1:
            raise UsageError("--placement places one task: start the others afterwards")
        placed = (
            place(robot, tasks[0], method=placement, fewer=True) if placement else None
        )
        with (
            Interrupts() as interrupts,
            up(
                robot,
                tasks,
                placement=placed,
                journal=journal,
                metrics=metrics,
                otel=otel,
                record=record,
                adapt=adapt,
                take_over=take_over,
                say=say,
                check=interrupts.check,
            ) as running,
            dashboard_beside(robot.name) if dashboard else contextlib.nullcontext(),
        ):
            ends = "Ctrl-C" if sys.stdin.isatty() else "`poise stop`"
            names = "' and '".join(tasks)
            say(f"robot '{robot.name}' is up with task '{names}'; {ends} ends it")
            while not running.wait(_POLL_EVERY):
                interrupts.check()
                keep_log_small()
            say("stopping")
        if running.started.live.remaining or running.unrecorded:  # it was said
            raise typer.Exit(1)


_CLONE = Path(__file__).parents[3]


def demo_command(
    as_json: AsJson = False,
    scene: Annotated[
        Literal[
            "overload",
            "lost-computer",
            "lost-leader",
            "cut-link",
            "cut-one-link",
            "frozen-agent",
            "manager-killed",
            "tasks",
        ]
        | None,
        typer.Option(help="Show instead how a running robot adapts, or runs tasks."),
    ] = None,
) -> None:
    """Drive a home service robot through a home, placed by hand and by Poise.

    25 components on two emulated computers, as in the paper's case study: first all on
    the main computer that can run there, then where Poise puts them. Takes about a
    minute, and draws both drives in poise-demo.svg.

    With --scene, a small robot adapts by itself: other programs overload one of its
    computers, a computer loses power, or that of the manager does, or one is cut off,
    one link of three is cut, an agent is stopped, or the manager is killed amid a move;
    or three tasks share functions, and one pauses another.

    The robots and the home are in the folder `examples` of Poise's repository: run it
    in a clone.

    Examples
    --------
    poise demo

    poise demo --scene overload
    """
    demo = demo_module()
    if scene is None:
        demo.play_drives(as_json=as_json)
    else:
        demo.play_scene(scene, as_json=as_json)


def demo_module() -> ModuleType:
    """Return `examples/demo/play.py` of the clone where this, or the command, is."""
    for clone in (_CLONE, Path.cwd()):
        if (clone / "examples/demo/play.py").is_file():
            sys.path.insert(0, str(clone))
            return importlib.import_module("examples.demo.play")
    raise UsageError(
        "the demo is in the folder `examples` of Poise's repository, which is not "
        f"installed with Poise: clone it, and run `poise demo` there (not {Path.cwd()})"
    )


def deploy_command(file: RobotFile, as_json: AsJson = False, set_: Set = None) -> None:
    """Send a robot's code to its computers, beside the code that is there.

    It packs what components import from the folders of the robot file and of its
    `repository`. Nothing that runs changes: the next `poise up` runs the new version.
    A computer that lacks room, or that is lost meanwhile, keeps what it has.

    Example: poise deploy robot.yaml
    """
    say = partial(typer.echo, err=True)
    robot = load(file, arguments_of(set_), say=say)
    with Interrupts() as interrupts:
        deployed = deploy(robot, say=say, check=interrupts.check)
    show(deployed, [str(deployed)], as_json=as_json)
