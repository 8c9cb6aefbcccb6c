"""`poise agent install` and `uninstall`: systemd runs this computer's agent."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from poise.cli.agent_command import (
    AddressOption,
    ComputerName,
    RobotName,
    allowed,
    check_ip,
    keys_for,
)
from poise.endpoint import AGENT_PORT
from poise.session.agent_service import AgentService

_IS_NOT_ROOT = os.getuid() != 0
_OwnUser = Annotated[
    bool,
    typer.Option(
        "--user/--system", help="This user's systemd, or (for root) the machine's."
    ),
]
_Folder = Annotated[
    Path | None,
    typer.Option(help="Write the unit into this folder, and start nothing."),
]


def install_command(
    computer: ComputerName,
    robot: RobotName,
    address: AddressOption,
    port: Annotated[int, typer.Option(help="As of `poise agent`.")] = AGENT_PORT,
    gateway: Annotated[int, typer.Option(help="As of `poise agent`.")] = 0,
    keys: Annotated[Path | None, typer.Option(help="As of `poise agent`.")] = None,
    insecure: Annotated[
        bool, typer.Option("--insecure", help="As of `poise agent`.")
    ] = False,
    allow: Annotated[
        list[Path] | None, typer.Option(help="As of `poise agent`; again for more.")
    ] = None,
    user: _OwnUser = _IS_NOT_ROOT,
    run_as: Annotated[
        str, typer.Option(help="With --system: the account that the agent runs as.")
    ] = "",
    unit_folder: _Folder = None,
) -> None:
    """Write a unit of systemd that runs the agent, and start it, now and at each boot.

    systemd restarts the agent when it dies or hangs; its containers go on meanwhile.

    Example: poise agent install left --robot hello --address 10.0.0.1 --run-as robot
    """
    check_ip(address)
    arguments = ["--robot", robot, "--address", address, "--port", str(port)]
    if gateway:
        arguments += ["--gateway", str(gateway)]
    # another user's keys are looked for when his agent starts
    if keys or not run_as:
        found = keys_for(robot, address, keys, is_insecure=insecure)
        arguments += ["--keys", found] if found else []
    if insecure:
        arguments.append("--insecure")
    for place in (allowed(address, allow) or ("/",)) if allow else ():
        arguments += ["--allow", place]
    service = AgentService(robot, computer, is_users=user, folder=unit_folder)
    is_started = service.install(service.text(arguments, run_as))
    _say(
        f"{service.path} runs the agent; `journalctl {'--user ' * user}-u "
        f"{service.name}` shows its log"
        if is_started
        else f"{service.path} is written, and starts when systemd enables it: "
        f"`systemctl {'--user ' * user}enable --now {service.name}`"
    )
    if is_started and user:
        _say("`loginctl enable-linger` lets it run when you are not logged in")


def uninstall_command(
    computer: ComputerName,
    robot: RobotName,
    user: _OwnUser = _IS_NOT_ROOT,
    unit_folder: _Folder = None,
) -> None:
    """Stop the agent that systemd runs, with its containers, and remove the unit.

    Example: poise agent uninstall left --robot hello
    """
    service = AgentService(robot, computer, is_users=user, folder=unit_folder)
    service.uninstall()
    _say(f"{service.path} is removed")


def _say(sentence: str) -> None:
    sys.stdout.write(f"{sentence}\n")
