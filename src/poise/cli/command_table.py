"""The commands of `poise`: each has a line here and a function in `command/`."""

from __future__ import annotations

import importlib
import inspect
import sys
from collections.abc import Sequence
from typing import Annotated

import typer

COMMANDS = {
    "check": ("check:check_command", "Check a robot file and the code that it names."),
    "plan": ("plan:plan_command", "Decide where each component runs."),
    "draw": ("draw:draw_command", "Draw components, placements or a transition."),
    "profile": ("profile:profile_command", "Measure what each component needs."),
    "profile show": ("profile:show_command", "Show the last profile."),
    "calibrate": ("calibrate:calibrate_command", "Measure computers and connectors."),
    "recording": ("recording:recording_command", "Export or replay a recording."),
    "policy": ("policy:policy_command", "Show what a robot does by itself, and when."),
    "repository": ("repository:list_command", "Show what provides which function."),
    "repository list": ("repository:list_command", "List architectures by function."),
    "repository show": ("repository:show_command", "Show an architecture's success."),
    "repository reset": ("repository:reset_command", "Forget what was learned of it."),
    "run": ("run:run_command", "Run a task for a while and report."),
    "demo": ("demo:demo_command", "Drive a robot, placed by hand and by Poise."),
    "emulate": ("emulate:emulate_command", "Keep a robot's emulated computers up."),
    "emulate list": ("emulate:list_command", "Show what is up, and the faults there."),
    "emulate cut": ("emulate:cut_command", "Cut computers from each other."),
    "emulate slow": ("emulate:slow_command", "Slow a link down."),
    "emulate heal": ("emulate:heal_command", "End a cut, or make a link quick again."),
    "emulate crash": ("emulate:crash_command", "Kill all processes of a computer."),
    "emulate freeze": ("emulate:freeze_command", "Stop all processes of a computer."),
    "emulate boot": ("emulate:boot_command", "Bring a computer back."),
    "emulate load": ("emulate:load_command", "Let a program take CPU on a computer."),
    "emulate stop": ("emulate:stop_command", "End the emulated computers of a robot."),
    "up": ("up:up_command", "Start a robot and keep it running."),
    "top": ("top:top_command", "Watch a running robot in the terminal."),
    "list": ("look:list_command", "List robots that run, and what they consist of."),
    "echo": ("look:echo_command", "Show messages as they go out over a connector."),
    "hz": ("look:hz_command", "Show how often something goes out over a connector."),
    "log": ("look:log_command", "Show what components wrote."),
    "task": ("task:list_command", "Start, pause, resume and cancel tasks."),
    "task start": ("task:start_command", "Start a task of a running robot."),
    "task pause": ("task:pause_command", "Let a task rest."),
    "task resume": ("task:resume_command", "Let a paused task go on."),
    "task cancel": ("task:cancel_command", "End a task."),
    "task list": ("task:list_command", "List the tasks that were started."),
    "task show": ("task:show_command", "Show a task and its actions."),
    "status": ("running_robot:status_command", "Show how a running robot is."),
    "dashboard": ("dashboard:dashboard_command", "Show a running robot as a web page."),
    "move": ("running_robot:move_command", "Move a component of a running robot."),
    "replace": ("running_robot:replace_command", "Swap a component's implementation."),
    "balance": ("running_robot:balance_command", "Rebalance a running robot."),
    "journal": ("journal:journal_command", "Show what a manager decided and why."),
    "stop": ("running_robot:stop_command", "Stop a running robot."),
    "agent": ("agent:agent_command", "Run what the manager wants on this computer."),
}
"""Command -> file and function in `command/`, and what it does. A second word makes a
sub-command."""


def build(arguments: Sequence[str]) -> typer.Typer:
    """Return the command line; only the command that is asked for is imported."""
    app = typer.Typer(
        help="Keeps a robot's software in balance over its on-board computers.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_main_options)
    words = [word for word in arguments if not word.startswith("-")]
    both = " ".join(words[:2])
    asked = both if both in COMMANDS else "".join(words[:1])
    for name, (where, help_) in COMMANDS.items():
        if name == asked:
            module, function = where.split(":")
            loaded = importlib.import_module(f"poise.cli.command.{module}")
            command = getattr(loaded, function)
            group, last = _group_of(app, name)
            group.command(last, help=_flowing(inspect.getdoc(command) or ""))(command)
        elif not asked.startswith(f"{name} "):
            app.command(name, help=help_)(_not_loaded)
    return app


def _group_of(app: typer.Typer, name: str) -> tuple[typer.Typer, str]:
    """Return where a command belongs, and its name there."""
    first, _, second = name.partition(" ")
    if not second:
        return app, first
    group = typer.Typer(callback=_not_loaded)  # or its one command would stand for it
    app.add_typer(group, name=first, help=COMMANDS[first][1])
    return group, second


def _flowing(text: str) -> str:
    """Return help whose paragraphs fill the terminal's width, whatever that is."""
    about, examples, commands = text.partition("\n\nExamples\n")
    paragraphs = (" ".join(each.split("\n")) for each in about.split("\n\n"))
    return "\n\n".join(paragraphs) + examples + commands


def _show_version(*, asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        sys.stdout.write(f"poise {version('poise')}\n")
        raise typer.Exit


def _not_loaded() -> None:
    """Stand for a command in the list of commands."""


def _main_options(
    *,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, help="Show the version."),
    ] = False,
) -> None:
    """Take the options of `poise` itself."""
