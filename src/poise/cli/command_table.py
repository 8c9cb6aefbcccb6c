"""The commands of `poise`: each has a line here and a function in its file."""

from __future__ import annotations

import importlib
import inspect
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from poise.errors import UsageError, did_you_mean, listed
from poise.version import VERSION

COMMANDS = {
    "check": ("robot_file", "Check a robot file and the code that it names."),
    "plan": ("plan", "Decide where each component runs."),
    "simulate": ("simulate", "Simulate a task in virtual time."),
    "draw": ("convert", "Draw components, placements or a transition."),
    "profile": ("profile", "Measure what each component needs."),
    "profile show": ("profile", "Show the last profile."),
    "calibrate": ("profile", "Measure computers and connectors."),
    "play": ("recording", "Publish a recording into a running robot."),
    "recording": ("recording", "Export or replay a recording."),
    "policy": ("robot_file", "Show what a robot does by itself, and when."),
    "repository": ("robot_file", "Show what provides which function."),
    "repository list": ("robot_file", "List architectures by function."),
    "repository show": ("robot_file", "Show an architecture's success."),
    "repository reset": ("robot_file", "Forget what was learned of an architecture."),
    "run": ("run", "Run a task for a while and report."),
    "demo": ("run", "Drive a robot, placed by hand and by Poise."),
    "emulate": ("emulate", "Keep a robot's emulated computers up."),
    "emulate list": ("emulate", "Show what is up, and the faults there."),
    "emulate cut": ("emulate", "Cut computers from each other."),
    "emulate slow": ("emulate", "Slow a link down."),
    "emulate heal": ("emulate", "End a cut or a slow link."),
    "emulate crash": ("emulate", "Kill all processes of a computer."),
    "emulate freeze": ("emulate", "Stop all processes of a computer."),
    "emulate boot": ("emulate", "Bring a computer back."),
    "emulate load": ("emulate", "Put CPU load on a computer."),
    "emulate stop": ("emulate", "End the emulated computers of a robot."),
    "keys": ("keys", "Make the keys of a robot's computers and people."),
    "keys init": ("keys", "Make a robot's authority, and your keys."),
    "keys issue": ("keys", "Make or renew keys of computers or people."),
    "keys list": ("keys", "Show the keys that are here."),
    "keys rotate": ("keys", "Replace the authority, step by step."),
    "deploy": ("run", "Send a robot's code to its computers."),
    "up": ("run", "Start a robot and keep it running."),
    "top": ("watch", "Watch a running robot in the terminal."),
    "list": ("watch", "List running robots and their parts."),
    "echo": ("watch", "Show the messages of a connector."),
    "hz": ("watch", "Show the rate of a connector's messages."),
    "call": ("outside", "Call a component of a running robot."),
    "pub": ("outside", "Send a message into a running robot."),
    "param": ("outside", "Show and set parameters of components."),
    "param list": ("outside", "List the parameters of all components."),
    "param get": ("outside", "Print a component's parameters."),
    "param set": ("outside", "Set parameters of a component that runs."),
    "ros2": ("convert", "Import and export ROS 2 nodes."),
    "ros2 import": ("convert", "Write a running ROS 2 graph as a robot file."),
    "ros2 export": ("convert", "Write launch files for ROS 2 nodes."),
    "record": ("recording", "Record a running robot for Foxglove."),
    "log": ("watch", "Show what components wrote."),
    "task": ("running_robot", "Start, pause, resume and cancel tasks."),
    "task start": ("running_robot", "Start a task of a running robot."),
    "task pause": ("running_robot", "Pause a task."),
    "task resume": ("running_robot", "Resume a paused task."),
    "task cancel": ("running_robot", "End a task."),
    "task list": ("running_robot", "List the tasks that were started."),
    "task show": ("running_robot", "Show a task and its actions."),
    "status": ("running_robot", "Show the state of a running robot."),
    "dashboard": ("watch", "Show a running robot as a web page."),
    "move": ("running_robot", "Move a component of a running robot."),
    "replace": ("running_robot", "Swap a component's implementation."),
    "balance": ("running_robot", "Rebalance a running robot."),
    "journal": ("watch", "Show what a manager decided and why."),
    "stop": ("running_robot", "Stop a running robot."),
    "agent": ("agent", "Run what the manager wants on this computer."),
    "agent install": ("agent", "Let systemd run this computer's agent."),
    "agent uninstall": ("agent", "Stop and remove that service."),
    "witness": ("agent", "Vote for a robot's manager, and run nothing."),
    "standby": ("agent", "Wait to lead a robot; agents start it."),
}
"""Command -> its file (`watch`: `watch_command.py`), and what it does. A second word
makes a sub-command. Its function is named after its last word: `stop_command`."""

_NAMING = {"agent"}
"""Commands whose second word may also be a name: it is no mistake."""

_EXIT_CODES = (
    "Exit codes: 0 done; 1 the robot file has problems, nothing can be placed, or "
    "something failed; 2 wrong arguments, or refused; 3 another manager has the "
    "robot; 4 no manager answers; 128 + n ended by signal n (130: Ctrl-C)."
)


def build(arguments: Sequence[str], *, completes: bool = False) -> typer.Typer:
    """Return the command line, or what of it a shell may complete (`completes`)."""
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
    if completes and asked == "".join(words[:1]) and not arguments[-1].startswith("-"):
        asked = _offer_seconds(app, asked, "".join(words[1:2]))
    for name, (where, help_) in COMMANDS.items():
        if name == asked:
            loaded = importlib.import_module(f"poise.cli.{where}_command")
            group, last = _group_of(app, name)
            command = getattr(loaded, f"{last}_command")
            help_text = _flowing(inspect.getdoc(command) or "")
            group.command(last, help=help_text, epilog=_EXIT_CODES)(command)
        elif name != asked.partition(" ")[0] and not (completes and " " in name):
            app.command(name, help=help_)(_not_loaded)
    return app


def check_words(arguments: Sequence[str]) -> None:
    """Raise UsageError for a second word that is neither a command nor a file."""
    first, second, *_ = (*arguments, "", "")
    choices = _seconds(first)
    is_word = second[:1].isalpha() and not {".", "/"} & {*second}
    is_word &= first not in _NAMING
    if choices and is_word and second not in choices and not Path(second).exists():
        raise UsageError(
            f"there is no command '{first} {second}'{did_you_mean(second, choices)}, "
            f"and no file '{second}'; commands: {listed(choices)}"
        )


def _seconds(first: str) -> list[str]:
    """Return the second words that make sub-commands of a command."""
    return [n.partition(" ")[2] for n in COMMANDS if n.startswith(f"{first} ")]


def _offer_seconds(app: typer.Typer, first: str, begun: str) -> str:
    """Add the sub-commands that a second word may become; return what is asked for."""
    offers = [second for second in _seconds(first) if second.startswith(begun)]
    if not offers:
        return first
    group = typer.Typer(callback=_not_loaded)
    app.add_typer(group, name=first)
    for second in offers:
        group.command(second, help=COMMANDS[f"{first} {second}"][1])(_not_loaded)
    return f"{first} {begun}"


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
    paragraphs = (" ".join(paragraph.split("\n")) for paragraph in about.split("\n\n"))
    return "\n\n".join(paragraphs) + examples + commands


def _show_version(*, asked: bool) -> None:
    if asked:
        sys.stdout.write(f"poise {VERSION}\n")
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
