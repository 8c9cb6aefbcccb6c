"""The commands of `poise`: each has a line here and a function in `command/`."""

from __future__ import annotations

import importlib
import inspect
import sys
from collections.abc import Sequence
from typing import Annotated

import typer

COMMANDS = {
    "check": ("design_time.check", "Check a robot file and the code that it names."),
    "plan": ("design_time.plan", "Decide where each component runs."),
    "simulate": ("design_time.simulate", "Simulate a task in virtual time."),
    "draw": ("design_time.draw", "Draw components, placements or a transition."),
    "profile": ("design_time.profile", "Measure what each component needs."),
    "profile show": ("design_time.profile", "Show the last profile."),
    "calibrate": ("design_time.calibrate", "Measure computers and connectors."),
    "recording": ("design_time.recording", "Export or replay a recording."),
    "policy": ("design_time.policy", "Show what a robot does by itself, and when."),
    "repository": ("design_time.repository", "Show what provides which function."),
    "repository list": ("design_time.repository", "List architectures by function."),
    "repository show": ("design_time.repository", "Show an architecture's success."),
    "repository reset": ("design_time.repository", "Forget what was learned of it."),
    "run": ("run_time.run", "Run a task for a while and report."),
    "demo": ("run_time.demo", "Drive a robot, placed by hand and by Poise."),
    "emulate": ("run_time.emulate", "Keep a robot's emulated computers up."),
    "emulate list": ("run_time.emulate", "Show what is up, and the faults there."),
    "emulate cut": ("run_time.emulate", "Cut computers from each other."),
    "emulate slow": ("run_time.emulate", "Slow a link down."),
    "emulate heal": ("run_time.emulate", "End a cut, or make a link quick again."),
    "emulate crash": ("run_time.emulate", "Kill all processes of a computer."),
    "emulate freeze": ("run_time.emulate", "Stop all processes of a computer."),
    "emulate boot": ("run_time.emulate", "Bring a computer back."),
    "emulate load": ("run_time.emulate", "Let a program take CPU on a computer."),
    "emulate stop": ("run_time.emulate", "End the emulated computers of a robot."),
    "up": ("run_time.up", "Start a robot and keep it running."),
    "top": ("run_time.top", "Watch a running robot in the terminal."),
    "list": ("run_time.look", "List robots that run, and what they consist of."),
    "echo": ("run_time.look", "Show messages as they go out over a connector."),
    "hz": ("run_time.look", "Show how often something goes out over a connector."),
    "record": ("run_time.record", "Record a running robot for Foxglove."),
    "log": ("run_time.look", "Show what components wrote."),
    "task": ("run_time.task", "Start, pause, resume and cancel tasks."),
    "task start": ("run_time.task", "Start a task of a running robot."),
    "task pause": ("run_time.task", "Let a task rest."),
    "task resume": ("run_time.task", "Let a paused task go on."),
    "task cancel": ("run_time.task", "End a task."),
    "task list": ("run_time.task", "List the tasks that were started."),
    "task show": ("run_time.task", "Show a task and its actions."),
    "status": ("run_time.running_robot", "Show how a running robot is."),
    "dashboard": ("run_time.dashboard", "Show a running robot as a web page."),
    "move": ("run_time.running_robot", "Move a component of a running robot."),
    "replace": ("run_time.running_robot", "Swap a component's implementation."),
    "balance": ("run_time.running_robot", "Rebalance a running robot."),
    "journal": ("run_time.journal", "Show what a manager decided and why."),
    "stop": ("run_time.running_robot", "Stop a running robot."),
    "agent": ("run_time.agent", "Run what the manager wants on this computer."),
}
"""Command -> its file in `command/`, and what it does. A second word makes a
sub-command. Its function is named after its last word: `stop_command`."""

_EXIT_CODES = (
    "Exit codes: 0 done; 1 the robot file has problems, nothing can be placed, or "
    "something failed; 2 wrong arguments, or refused; 3 another manager took over; "
    "128 + n ended by signal n (130: Ctrl-C)."
)


def build(arguments: Sequence[str]) -> typer.Typer:
    """Return the command line; only the command that is asked for is imported."""
    app = typer.Typer(
        help="Keeps a robot's software in balance over its on-board computers.",
        epilog=_EXIT_CODES,
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
            loaded = importlib.import_module(f"poise.cli.command.{where}")
            group, last = _group_of(app, name)
            command = getattr(loaded, f"{last}_command")
            help_text = _flowing(inspect.getdoc(command) or "")
            group.command(last, help=help_text, epilog=_EXIT_CODES)(command)
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
