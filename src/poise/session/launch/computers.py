"""The robot's computers, up and with an agent each: real ones, or emulated here."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from poise.clock import SystemClock
from poise.emulate import EmulatedComputer, Emulation, StarvationWatch
from poise.endpoint import AGENT_PORT, Endpoint
from poise.errors import RunError
from poise.model.robot import Robot
from poise.session.launch.printer import STDERR, Printer, relay
from poise.session.say import Say
from poise.units import counted
from poise.wire.control_session import LEASE, locator
from poise.wire.records.samples import SAMPLE_EVERY

_TOLERATED = 0.1
"""A run is invalid when the host starved computers for more than this share of it."""


class Computers:
    """The computers of a run.

    Parameters
    ----------
    endpoints
        Computer -> zenoh endpoint of its agent.
    without
        What the emulation does without.
    watch
        Returns a watch for starvation by the host; None: the computers are real.
    agents
        Computer -> the process of its agent, where it was started here.
    faster
        Computer -> how many times more CPU it has than the robot file says.
    emulated
        The emulated computers, by name; none of a real robot.

    Attributes
    ----------
    lease
        An agent that is silent for this time [s] is lost.
    """

    def __init__(
        self,
        endpoints: Mapping[str, str],
        without: tuple[str, ...] = (),
        watch: Callable[[], StarvationWatch] | None = None,
        agents: Mapping[str, subprocess.Popen[bytes]] | None = None,
        faster: Mapping[str, float] | None = None,
        emulated: Mapping[str, EmulatedComputer] | None = None,
    ) -> None:
        self.endpoints = endpoints
        self.faster = faster or {}
        self.emulated = emulated or {}
        self._agents = agents or {}
        # nothing can cut off agents that were started here, but they may be starved
        self.lease = 10.0 if agents else LEASE
        self.without = without
        self._make_watch = watch
        self._watch: StarvationWatch | None = None
        self._clock = SystemClock()
        self._began = 0.0

    def raise_if_ended(self) -> None:
        """Raise RunError when the process of an agent ended."""
        for name, process in self._agents.items():
            if (code := process.poll()) is not None:
                raise RunError(f"the agent of '{name}' ended with exit code {code}")

    def begin(self) -> None:
        """Judge from now on whether the host gives what the emulation promised."""
        self._began = self._clock.now()
        self._watch = self._make_watch() if self._make_watch else None

    def look(self) -> None:
        """Judge the moment; call it a few times a second."""
        if self._watch is not None:
            self._watch.look()

    def end(self, of: str | None = None) -> str:
        """Return why the run says nothing about the robot; empty when it does.

        Parameters
        ----------
        of
            The computer that the run is about; None: all of them.
        """
        starved = self._watch.end() if self._watch is not None else {}
        if of is not None:
            starved = {name: t for name, t in starved.items() if name == of}
        lasted = self._clock.now() - self._began
        if sum(starved.values()) <= _TOLERATED * lasted:
            return ""
        times = ", ".join(f"{name} for {t:.1f} s" for name, t in starved.items())
        return (
            "this machine was too busy to give the emulated computers the CPU they "
            f"were promised ({times}): run it again when less else runs"
        )


@contextlib.contextmanager
def computers_of(
    robot: Robot, folder: Path, say: Say, sample_every: float = SAMPLE_EVERY
) -> Iterator[Computers]:
    """Give the robot's real computers, or emulate all of them on this one.

    Parameters
    ----------
    sample_every
        How often emulated computers tell what they use [s]; real ones were told by
        ``poise agent``.
    """
    addresses = {c.name: c.address for c in robot.computers if c.address}
    if not addresses:
        with _emulated(robot, folder, say, sample_every) as computers:
            yield computers
        return
    yield Computers({n: locator(Endpoint.parse(a)) for n, a in addresses.items()})


@contextlib.contextmanager
def _emulated(
    robot: Robot, folder: Path, say: Say, sample_every: float
) -> Iterator[Computers]:
    say(f"emulating {counted(len(robot.computers), 'computer')} on this one")
    # an agent ends at the end of its lifeline, so even a killed manager leaves none
    lifeline, held = os.pipe()
    try:
        with (
            # what components print must not get into a JSON report
            Printer(STDERR) as printer,
            relay(printer) as output,
            Emulation(robot, folder) as emulation,
        ):
            for sentence in emulation.without:
                say(f"  without {sentence}")
            computers = emulation.computers
            agents_at = {
                name: Endpoint(computer.address, AGENT_PORT)
                for name, computer in computers.items()
            }
            agents = {}
            for name in computers:
                argv = _agent(robot.name, emulation, name, agents_at)
                argv += ["--lifeline", str(lifeline)]
                argv += ["--sample-every", str(sample_every)]
                agents[name] = computers[name].popen(
                    argv,
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=output,
                    pass_fds=[lifeline],
                )
            yield Computers(
                {name: locator(agent) for name, agent in agents_at.items()},
                emulation.without,
                lambda: StarvationWatch(computers, SystemClock()),
                agents,
                {name: computer.slowdown for name, computer in computers.items()},
                computers,
            )
    finally:
        os.close(lifeline)
        os.close(held)


def _agent(
    robot: str, emulation: Emulation, name: str, agents_at: Mapping[str, Endpoint]
) -> list[str]:
    """Return the command line of a computer's agent."""
    computer = emulation.computers[name]
    argv = [sys.executable, "-m", "poise", "agent", name, "--robot", robot]
    argv += ["--address", computer.address, "--folder", str(computer.folder)]
    for other, agent in agents_at.items():
        if other != name:
            argv += ["--peer", str(agent)]
    return argv
