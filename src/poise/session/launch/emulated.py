"""Keeps the emulated computers of a robot up, for runs and rehearsed faults."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from poise.emulate import EmulatedSet, find_set
from poise.errors import UsageError
from poise.manage.control_socket.agent_addresses import forget
from poise.model.robot import Robot
from poise.session.callbacks import Say, log
from poise.session.launch.emulated_agents import emulated_agents
from poise.session.launch.temporary_folders import scratch_folder


@contextlib.contextmanager
def emulated(robot: Robot, *, say: Say = log.info) -> Iterator[EmulatedSet]:
    """Emulate a robot's computers inside the ``with`` block, with an agent on each.

    Meanwhile `run` and `up` of this robot use them, from any process of this user, and
    leave them up. An agent that ends is started again, as systemd would on a real
    computer, unless its computer was crashed.

    Parameters
    ----------
    say
        Takes sentences, also on a thread of its own.

    Raises
    ------
    UsageError
        The robot's computers have addresses, or are kept by another process.
    RobotError, RunError
        They cannot be emulated; nothing is left.
    """
    real = [computer.name for computer in robot.computers if computer.address]
    if real:
        raise UsageError(
            f"robot '{robot.name}' has real computers ({', '.join(real)}): only "
            "computers without `address` are emulated"
        )
    with (
        scratch_folder("poise-run-") as folder,
        emulated_agents(robot, folder / "computers", say, keep=True),
    ):
        try:
            yield find_set(robot.name)
        finally:
            forget(robot.name)  # what runs there ends, with a manager or without
