"""How one watches a running robot: `poise list`, `echo`, `hz`, `top`, `dashboard`."""

from __future__ import annotations

import contextlib
import importlib.util
import math
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from msgspec.structs import replace
from rich.console import Console
from rich.markup import escape

from poise.cli.options import AsJson, as_yaml, parse_option, print_json, running, show
from poise.cli.running_robot_command import Robot
from poise.clock import date_and_time, time_of_day
from poise.endpoint import is_loopback
from poise.errors import UsageError
from poise.manage.agent_connections.statuses import connectors_of
from poise.manage.journal import KINDS, JournalEntry, read_journal
from poise.runtime.hosting.command_line import die_with_parent
from poise.session.folders import find_journal
from poise.session.launch.printer import visible
from poise.session.render.printable import console_to
from poise.session.running_robots.local_robots import (
    Rate,
    Thing,
    listing,
    names_of,
    robots_here,
)
from poise.session.running_robots.running import Running, connect
from poise.units import SECONDS
from poise.wire.credentials import Credentials, find
from poise.wire.records.request_records import OutputLine
from poise.wire.records.status_records import Summary

Connector = Annotated[
    str,
    typer.Argument(
        help="Its name, or component.port of one of its ends.",
        autocompletion=running("connectors"),
    ),
]


def list_command(
    what: Annotated[
        Thing | None, typer.Argument(help="Print only names of these, one a line.")
    ] = None,
    robot: Robot = None,
    as_json: AsJson = False,
) -> None:
    """List the robots that run here, with their components and connectors.

    Examples
    --------
    poise list

    poise list connectors
    """
    robots = robots_here(robot)
    if what is None:
        show(robots, listing(robots), as_json=as_json)
    elif as_json:
        print_json(list(names_of(robots, what)))
    else:
        sys.stdout.writelines(f"{name}\n" for name in names_of(robots, what))


def echo_command(
    connector: Connector,
    rate: Annotated[
        float, typer.Option(help="The most messages to show in a second.")
    ] = 10.0,
    count: Annotated[
        int | None, typer.Option(min=1, help="End after so many messages.")
    ] = None,
    robot: Robot = None,
    as_json: AsJson = False,
) -> None:
    """Show the messages or calls that go out over a connector, until Ctrl-C.

    Long values are shortened. What is not shown is counted on standard error. With
    --json each message is one line. The robot does not wait for this.

    Examples
    --------
    poise echo counter.count

    poise echo counter.count --count 1 --json
    """
    if not (math.isfinite(rate) and rate > 0):
        raise UsageError(f"--rate {rate:g}: must be a positive number of messages")
    shown = 0
    for reading in Running(robot).echo(connector, rate=rate):
        for passed in reading.passed[: None if count is None else count - shown]:
            if as_json:
                print_json({"at": passed.at, "value": passed.value})
            else:
                moment = f"{time_of_day(passed.at)}.{int(passed.at % 1 * 1000):03}"
                sys.stdout.write(f"--- {moment}\n{as_yaml(passed.value)}")
            shown += 1
        sys.stdout.flush()
        more = len(reading.times) + reading.missing - len(reading.passed)
        if count is not None and shown >= count:
            return
        if more:
            sys.stderr.write(f"# {more} more, not shown\n")


def log_command(
    component: Annotated[
        str,
        typer.Argument(
            help="Only what this component wrote.", autocompletion=running("components")
        ),
    ] = "",
    last: Annotated[int, typer.Option(min=1, help="At most the last N lines.")] = 100,
    follow: Annotated[
        bool, typer.Option("--follow", "-f", help="Wait for further lines.")
    ] = False,
    robot: Robot = None,
    as_json: AsJson = False,
) -> None:
    """Show what components wrote to standard output and error, and what they logged.

    At least the last 256 KiB of each container are kept, also after it has crashed.
    What a thread wrote that a component started itself has the name of the container,
    and is shown when no component is named. With --json each line is an object.

    Examples
    --------
    poise log

    poise log printer --follow
    """
    silent: tuple[str, ...] = ()
    for reading in Running(robot).log(component, last=last, follow=follow):
        if reading.omitted:
            sys.stderr.write(f"# {reading.omitted} more before\n")
        for line in reading.lines:
            if as_json:
                print_json(line)
            else:
                sys.stdout.write(_log_line(line))
        sys.stdout.flush()
        if reading.silent != silent:
            silent = reading.silent
            said = f"no answer from {', '.join(silent)}" if silent else "all answer"
            sys.stderr.write(f"# {said}\n")
    if silent:  # what was written there may be what was looked for
        raise typer.Exit(1)


def _log_line(line: OutputLine) -> str:
    clock = time_of_day(line.at // 10**9)
    millis = line.at // 10**6 % 1000
    text = visible(line.text, colours=sys.stdout.isatty())
    return f"{clock}.{millis:03} {line.component}@{line.computer}: {text}\n"


def hz_command(
    connector: Connector,
    for_: Annotated[
        str, typer.Option("--for", help="How long each line covers, such as 5s.")
    ] = "1s",
    count: Annotated[
        int | None, typer.Option(min=1, help="End after so many lines.")
    ] = None,
    robot: Robot = None,
    as_json: AsJson = False,
) -> None:
    """Show how often and how regularly something goes out over a connector.

    A line each second until Ctrl-C: rate, times between two, their standard deviation
    (jitter), and how large messages are if they leave their container.

    Example: poise hz counter.count
    """
    seconds = parse_option("--for", for_, SECONDS)
    if not seconds > 0:
        raise UsageError(f"--for {for_}: a line must cover more than 0 s")
    running, lines = Running(robot), 0
    times: list[float] = []
    before, missing, until = None, 0, time.monotonic() + seconds
    for reading in running.echo(connector, rate=0.0):
        times += reading.times
        missing += reading.missing
        if time.monotonic() < until:
            continue
        rate = Rate.of(times, missing, before)
        size = _size(running, reading.connector)
        rate = replace(rate, size=size.median, largest=size.maximum)
        if as_json:
            print_json(rate)
        else:
            sys.stdout.writelines(f"{line}\n" for line in rate.lines())
        sys.stdout.flush()
        lines += 1
        if count is not None and lines >= count:
            return
        before = max(times, default=before)  # else the gap between would be lost
        times, missing, until = [], 0, time.monotonic() + seconds


def _size(running: Running, connector: str) -> Summary:
    for end in connectors_of(running.status().computers):
        if end.name == connector and end.end != "target":
            return end.size
    return Summary()


def top_command(
    every: Annotated[
        float, typer.Option(min=0.2, help="Seconds from one refresh to the next.")
    ] = 1.0,
    robot: Robot = None,
) -> None:
    """Watch a running robot: computers, components, connectors and last decisions.

    Works over ssh in 60 x 24 characters. Tab goes from table to table, s sorts by the
    next column, r the other way round, q quits. It goes on when the manager is
    restarted.

    Example: poise top
    """
    try:
        from poise.view.top import Top
    except ImportError as error:
        raise UsageError("poise top needs textual: pip install 'poise[top]'") from error
    if not (sys.stdin.isatty() and sys.stderr.isatty()):  # which it draws on
        raise UsageError(
            "poise top needs a terminal: `poise status` prints the same once"
        )
    Top(connect(robot).status, every).run()


_POLL_EVERY = 0.2
_COLOURS = {"wrong": "red", "failed": "red", "right": "green", "decided": "bold"}


def journal_command(
    file: Annotated[
        Path | None,
        typer.Argument(help="A journal. Default: the last robot's, or `--robot`'s."),
    ] = None,
    robot: Annotated[
        str | None, typer.Option(help="The robot whose last journal is shown.")
    ] = None,
    kind: Annotated[
        list[str] | None, typer.Option(help=f"Only these: {', '.join(KINDS)}.")
    ] = None,
    about: Annotated[
        str | None, typer.Option(help="Only entries that name this, such as 'vision'.")
    ] = None,
    last: Annotated[
        int | None, typer.Option(min=1, help="Only the last N entries.")
    ] = None,
    facts: Annotated[
        bool, typer.Option("--facts", help="With the facts of each: demands, costs.")
    ] = False,
    follow: Annotated[
        bool, typer.Option("--follow", help="Wait for further entries until Ctrl-C.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Show a manager's journal: what it saw, decided and did, and what came of it.

    Examples
    --------
    poise journal --kind decided --kind wrong --facts

    poise journal results/journal.jsonl --about vision --follow
    """
    if unknown := set(kind or ()) - set(KINDS):
        raise UsageError(f"--kind {unknown.pop()}: it is one of {', '.join(KINDS)}")
    if follow and as_json:
        raise UsageError("--follow and --json together: JSON is one whole object")

    def fits(entry: JournalEntry) -> bool:
        named = about is None or about in entry.what
        return named and (not kind or entry.kind in kind)

    if file is not None and robot is not None:
        raise UsageError("give a file or --robot, not both")
    if file is None:
        found = find_journal(robot)
        file = found.resolve()
        until = date_and_time(file.stat().st_mtime)
        sys.stderr.write(
            f"journal of robot '{found.parent.name}' until {until}: {file}\n"
        )
    entries = read_journal(file)
    chosen = [entry for entry in entries if fits(entry)]
    chosen = chosen[-last:] if last else chosen
    if as_json:
        print_json({"entries": chosen})
        return
    console = console_to()
    _show(console, chosen, facts=facts)
    after = entries[-1].number if entries else 0
    while follow:
        time.sleep(_POLL_EVERY)
        if new := read_journal(file, after):
            after = new[-1].number
            _show(console, [entry for entry in new if fits(entry)], facts=facts)


def _show(console: Console, entries: list[JournalEntry], *, facts: bool) -> None:
    for entry in entries:
        style = _COLOURS.get(entry.kind, "")
        console.print(escape(f"{entry.kind:8}{entry}"), style=style)
        if facts and entry.facts:
            text = msgspec.json.format(msgspec.json.encode(entry.facts), indent=2)
            console.print(escape(text.decode()), style="dim")


_PORT = 7480


def dashboard_command(
    robot: Annotated[
        str | None, typer.Argument(help="The robot's name, when several run here.")
    ] = None,
    host: Annotated[
        str,
        typer.Option(help="Address to listen on; others than loopback need a token."),
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="TCP port; 0: any that is free.")
    ] = _PORT,
    insecure: Annotated[
        bool, typer.Option("--insecure", help="Do not encrypt it for other computers.")
    ] = False,
) -> None:
    """Show a running robot as a web page, until Ctrl-C.

    Computers with their components, connectors, deadlines, and what Poise decided and
    why. Drag a component to another computer to see what a move would change. It waits
    for the robot, and for a new manager when that was killed.

    To other computers it is encrypted by the robot's keys (`poise keys`). It prints an
    address for people who may act, and one for people who may only look.

    Example: poise dashboard
    """
    check_dashboard()
    from poise.view.dashboard.dashboard_server import serve

    keys = None if insecure or is_loopback(host) else _keys(robot)

    serve(robot, host, _free_port(host, port), typer.echo, keys)


def _keys(robot: str | None) -> Credentials:
    """Return the keys that encrypt the page of a robot."""
    if robot is None:
        raise UsageError("name the robot: its keys encrypt the page")
    keys = find(robot, "manager", "viewer")
    if keys is None:
        raise UsageError(
            f"there are no keys of robot '{robot}' to encrypt the page with: `poise "
            "keys init` makes them; --insecure goes without; `ssh -L` needs neither"
        )
    return keys


def check_dashboard() -> None:
    """Raise UsageError when what the dashboard needs is not installed."""
    if importlib.util.find_spec("nicegui") is None:
        raise UsageError("the dashboard needs NiceGUI: pip install 'poise[dashboard]'")


@contextlib.contextmanager
def dashboard_beside(robot: str) -> Iterator[None]:
    """Serve the page by a process that ends with this block, and with this process."""
    try:
        port = _free_port("127.0.0.1", _PORT)
    except UsageError:  # the page of another robot
        port = 0
    words = ["dashboard", robot, "--port", str(port)]
    with subprocess.Popen(  # noqa: S603, Poise itself
        [sys.executable, "-m", "poise", *words],
        stdin=subprocess.DEVNULL,
        preexec_fn=die_with_parent,  # noqa: PLW1509, it is one call
    ) as server:
        try:
            yield
        finally:
            server.terminate()


def _free_port(host: str, port: int) -> int:
    """Return the port, or a free one for 0, if it can be listened on."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise UsageError(
                f"cannot listen on {host}:{port} ({error.strerror}): choose "
                "another with --host or --port; --port 0 takes any that is free"
            ) from error
        return int(probe.getsockname()[1])
