"""`poise dashboard`: a running robot as a local web page."""

from __future__ import annotations

import contextlib
import importlib.util
import socket
import subprocess
import sys
from collections.abc import Iterator
from typing import Annotated

import typer

from poise.errors import UsageError
from poise.runtime.hosting.command_line import die_with_parent
from poise.wire.credentials import Credentials, find

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
        bool,
        typer.Option("--insecure", help="Do not encrypt it for other computers."),
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
    from poise.view.dashboard.dashboard_server import is_loopback, serve

    keys = None if insecure or is_loopback(host) else _keys(robot)

    def say(text: str) -> None:
        sys.stdout.write(f"{text}\n")
        sys.stdout.flush()

    serve(robot, host, _free_port(host, port), say, keys)


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
                f"{host}:{port} cannot be listened on ({error.strerror}): choose "
                "another with --host or --port; --port 0 takes any that is free"
            ) from error
        return int(probe.getsockname()[1])
