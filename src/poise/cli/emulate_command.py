"""`poise emulate`: keep a robot's emulated computers up, and rehearse faults there."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated

import typer
from msgspec import Struct
from rich.markup import escape

from poise.cli.main import Interrupts
from poise.cli.options import AsJson, RobotFile, Set, arguments_of, parse_option, show
from poise.clock import time_of_day
from poise.emulate import EmulatedSet, InjectedFault, all_sets, find_set
from poise.errors import UsageError
from poise.session.launch.background_log import keep_log_small
from poise.session.launch.computers import emulated
from poise.session.launch.printer import Printer, log_printer
from poise.session.render.printable import console_to
from poise.session.robot_file import load
from poise.units import BANDWIDTH, CORES, SECONDS, Dimension
from poise.wire.robots_here import is_alive, path_of

_POLL_EVERY = 0.2

Robot = Annotated[
    str | None, typer.Option(help="The robot's name, if several are emulated.")
]
Computer = Annotated[str, typer.Argument(help="The computer.")]
Other = Annotated[str, typer.Argument(help="The other one.")]
AnyOther = Annotated[
    str | None, typer.Argument(help="The other computer. Default: all.")
]


class ListedSet(Struct, frozen=True, kw_only=True):
    """One robot's emulated computers.

    Parameters
    ----------
    process
        That keeps them.
    since
        When they were up [s since 1970].
    computers
        Computer -> IP address.
    """

    robot: str
    process: int
    since: float
    computers: Mapping[str, str]
    without: tuple[str, ...]
    faults: tuple[InjectedFault, ...]


def emulate_command(file: RobotFile, set_: Set = None) -> None:
    """Keep a robot's emulated computers up until Ctrl-C or `poise emulate stop`.

    Meanwhile `run`, `up` and `demo` use them and leave them up, and `poise emulate
    cut`, `slow`, `crash`, `freeze` and `load` rehearse faults there. An agent that ends
    is started again.

    Example: poise emulate robot.yaml
    """
    with Printer() as printer, log_printer():
        say = printer.print
        robot = load(file, arguments_of(set_), say=say)
        with Interrupts() as interrupts, emulated(robot, say=say) as kept:
            names = ", ".join(f"{c.name} {c.address}" for c in kept.computers.values())
            say(f"the computers of robot '{robot.name}' are up ({names}); Ctrl-C ends")
            while not interrupts.has_come():
                kept.state()  # raises when another process has removed it
                keep_log_small()
                time.sleep(_POLL_EVERY)
            say("stopping")


def list_command(as_json: AsJson = False) -> None:
    """Show the emulated computers that are kept up, and the faults in force there.

    Example: poise emulate list
    """
    states = [(kept, kept.state()) for kept in all_sets()]
    listed = [
        ListedSet(
            robot=kept.robot,
            process=kept.layout.owner.pid,
            since=state.since or 0.0,
            computers={name: each.address for name, each in kept.computers.items()},
            without=state.without,
            faults=state.faults,
        )
        for kept, state in states
    ]
    show(listed, map(escape, _lines(listed)), as_json=as_json)


def _lines(listed: list[ListedSet]) -> Iterator[str]:
    if not listed:
        yield "no emulated computers are kept up"
    for kept in listed:
        since = time_of_day(kept.since)
        names = ", ".join(f"{name} {at}" for name, at in kept.computers.items())
        yield f"{kept.robot}: {names}; since {since}, process {kept.process}"
        for sentence in (*(f"without {w}" for w in kept.without), *kept.faults):
            yield f"  {sentence}"


def cut_command(
    computer: Computer, other: AnyOther = None, robot: Robot = None
) -> None:
    """Cut two computers from each other, or one from all and from the manager.

    Packets vanish and no connection is reset, as when a cable is pulled, until
    `poise emulate heal`.

    Example: poise emulate cut main vision
    """
    kept = find_set(robot)
    kept.cut(computer, other)
    _say_last(kept)


def slow_command(
    computer: Computer,
    other: Other,
    bandwidth: Annotated[
        str | None, typer.Option(help="Each way, such as 1Mbit/s.")
    ] = None,
    latency: Annotated[str | None, typer.Option(help="One way, such as 20ms.")] = None,
    robot: Robot = None,
) -> None:
    """Slow the link between two computers down, until `poise emulate heal`.

    Example: poise emulate slow main vision --bandwidth 1Mbit/s
    """
    kept = find_set(robot)
    kept.slow(
        computer,
        other,
        bandwidth=_quantity("--bandwidth", bandwidth, BANDWIDTH),
        latency=_quantity("--latency", latency, SECONDS),
    )
    _say_last(kept)


def heal_command(
    computer: Computer, other: AnyOther = None, robot: Robot = None
) -> None:
    """End a cut, or make a slow link quick again.

    Example: poise emulate heal main vision
    """
    find_set(robot).heal(computer, other)
    what = f"'{computer}'" if other is None else f"the link {computer} - {other}"
    console_to().print(f"{what} is healed")


def crash_command(computer: Computer, robot: Robot = None) -> None:
    """Kill all processes of a computer at once, and cut its cable, until `boot`.

    Example: poise emulate crash vision
    """
    kept = find_set(robot)
    kept.crash(computer)
    _say_last(kept)


def freeze_command(
    computer: Computer,
    agent: Annotated[
        bool, typer.Option("--agent", help="Stop its agent only, not its containers.")
    ] = False,
    robot: Robot = None,
) -> None:
    """Stop all processes of a computer, as when its kernel hangs, until `boot`.

    Examples
    --------
    poise emulate freeze vision

    poise emulate freeze vision --agent
    """
    kept = find_set(robot)
    kept.freeze(computer, agent=agent)
    _say_last(kept)


def boot_command(computer: Computer, robot: Robot = None) -> None:
    """Bring a crashed or frozen computer or agent back; after a crash its agent starts.

    Example: poise emulate boot vision
    """
    find_set(robot).boot(computer)
    console_to().print(f"'{computer}' is back")


def load_command(
    computer: Computer,
    cpu: Annotated[str, typer.Option(help="How much: 0.3 cores, or 30%; 0 ends it.")],
    robot: Robot = None,
) -> None:
    """Let a program take CPU on a computer, beside the robot's components.

    Example: poise emulate load vision --cpu 0.3
    """
    kept, cores = find_set(robot), parse_option("--cpu", cpu, CORES)
    kept.load(computer, cores)
    if cores:
        _say_last(kept)
    else:
        console_to().print(f"the load on '{computer}' has ended")


def stop_command(
    file: Annotated[
        Path | None, typer.Argument(help="The robot's file, instead of its name.")
    ] = None,
    robot: Robot = None,
) -> None:
    """End the emulated computers of a robot, with all that runs on them.

    Examples
    --------
    poise emulate stop

    poise emulate stop robot.yaml
    """
    if file is not None and robot is not None:
        raise UsageError(f"give {file} or --robot, not both")
    found = find_set(load(file).name if file is not None else robot)
    name = found.robot
    found.stop()
    console_to().print(f"the emulated computers of robot '{name}' have stopped")
    if is_alive(path_of(name)):
        console_to().print(
            f"its manager goes on without them: `poise stop --robot {name}` ends it"
        )


def _say_last(kept: EmulatedSet) -> None:
    """Print the fault that was injected last, and what ends it."""
    fault = kept.state().faults[-1]
    console_to().print(f"{fault}; {fault.way_out}")


def _quantity(option: str, text: str | None, dimension: Dimension) -> float | None:
    return None if text is None else parse_option(option, text, dimension)
