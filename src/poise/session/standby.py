"""Waits on a robot's computer, and leads the robot when nobody else does."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable
from pathlib import Path

import msgspec
from msgspec.structs import replace

from poise.errors import RunError, TakenOver
from poise.manage.control_socket.control_server import ControlServer
from poise.manage.deploy.takeover import start_or_take_over
from poise.manage.journal import Journal
from poise.manage.tasks.concurrent_tasks import Tasks
from poise.runtime.container.component_import import folder_of_version
from poise.session import Say, nothing
from poise.session.folders import make_journal
from poise.session.launch.computers import Computers
from poise.session.launch.managed import StandbySetup, ToManage, managed
from poise.session.up import Up
from poise.wire.address import KEYS
from poise.wire.records.request_records import Claim
from poise.wire.robots_here import AgentAddresses


def stand_by(path: Path, words: Iterable[str], say: Say) -> None:
    """Lead as the claim in a file says, at each word ``lead``; else until the end.

    `words`: an agent's, one a line; its end is the agent's.
    """
    for word in words:
        if word.strip() == "end":
            return
        if word.strip() == "lead":
            claim = msgspec.msgpack.decode(path.read_bytes(), type=Claim)
            try:
                _lead(claim, say)
            except RunError as error:
                say(str(error))
                if isinstance(error, TakenOver):
                    return  # with all that it knew
            else:
                return


def _lead(claim: Claim, say: Say) -> None:
    """Become the leader of a robot that runs, and lead it to its end."""
    assert claim.election is not None  # noqa: S101, or there would be no standby
    setup = msgspec.msgpack.decode(claim.election.setup, type=StandbySetup)
    robot = replace(setup.robot, simulator=None)  # it ended with who started it
    if robot.deployed:  # what its policies call
        robot = replace(robot, folder=folder_of_version(robot.deployed))
    with contextlib.ExitStack() as stack:
        journal = Journal(make_journal(robot.name), lambda entry: say(str(entry)))
        stack.callback(journal.close)
        agents = AgentAddresses(robot.name, claim.agents, os.environ.get(KEYS, ""))
        what = ToManage(
            robot=robot,
            where={},
            tasks=Tasks(robot),
            election=claim.election,
            computers=Computers(agents),
        )
        it, manager = stack.enter_context(
            managed(
                what,
                journal,
                say,
                nothing,
                adapts=setup.adapts,
                recorder=None,
                begin=lambda run: start_or_take_over(run, follows=True),
            )
        )
        server = stack.enter_context(ControlServer(robot.name, takes_over=True))
        running = stack.enter_context(Up(it, manager))
        server.start(manager.submit)
        running.wait()
