"""The agents of emulated computers: started here, and gone with this process."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from poise.emulate import EmulatedComputer, Emulation
from poise.endpoint import AGENT_PORT, Endpoint
from poise.model.robot import Robot
from poise.session.callbacks import Say
from poise.session.launch.printer import STDERR, Printer, relay
from poise.units import counted
from poise.wire.control_session import LEASE
from poise.wire.records.samples import SAMPLE_EVERY

UNCUT_LEASE = 10.0
"""The lease of agents that nothing can cut off from their manager, but that may have to
wait for CPU [s]."""


class EmulatedAgents:
    """The agents of all emulated computers of a robot.

    Parameters
    ----------
    output
        A descriptor for what they and their components print.
    lifeline
        A descriptor at whose end of file they end.

    Attributes
    ----------
    processes
        Computer -> the process of its agent that was started last.
    """

    def __init__(
        self,
        robot: str,
        emulation: Emulation,
        output: int,
        lifeline: int,
        lease: float,
        sample_every: float,
    ) -> None:
        self.emulation = emulation
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self._robot = robot
        self._output = output
        self._lifeline = lifeline
        self._options = ["--lease", f"{lease}", "--sample-every", f"{sample_every}"]
        for name in emulation.computers:
            self.start(name)

    def start(self, name: str) -> None:
        """Start the agent of a computer, for the first time or after it ended."""
        computer = self.emulation.computers[name]
        argv = [sys.executable, "-m", "poise", "agent", name, "--robot", self._robot]
        argv += ["--address", computer.address, "--folder", str(computer.folder)]
        self.processes[name] = computer.popen(
            [*argv, "--lifeline", str(self._lifeline), *self._options],
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=self._output,
            pass_fds=[self._lifeline],
        )


def agent_of(computer: EmulatedComputer) -> Endpoint:
    """Return where the agent of an emulated computer listens."""
    return Endpoint(computer.address, AGENT_PORT)


@contextlib.contextmanager
def emulated_agents(
    robot: Robot,
    folder: Path,
    say: Say,
    *,
    sample_every: float = SAMPLE_EVERY,
    keep: bool = False,
) -> Iterator[EmulatedAgents]:
    """Emulate the computers of a robot, and start an agent on each.

    Parameters
    ----------
    sample_every
        How often they tell what they use [s].
    keep
        Whether other processes use them, and can inject faults.
    """
    say(f"emulating {counted(len(robot.computers), 'computer')} on this one")
    # an agent ends at the end of its lifeline, so even a killed process leaves none
    lifeline, held = os.pipe()
    try:
        with (
            # what components print must not get into a JSON report
            Printer(STDERR) as printer,
            relay(printer) as output,
            Emulation(robot, folder, keep=keep) as emulation,
        ):
            for sentence in emulation.without:
                say(f"  without {sentence}")
            lease = LEASE if keep else UNCUT_LEASE
            yield EmulatedAgents(
                robot.name, emulation, output, lifeline, lease, sample_every
            )
    finally:
        os.close(lifeline)
        os.close(held)
