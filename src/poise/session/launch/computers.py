"""The robot's computers, up and with an agent each: real ones, or emulated here."""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path

from poise.clock import SystemClock
from poise.emulate import EmulatedComputer, EmulatedSet, StarvationWatch, set_for
from poise.endpoint import Endpoint
from poise.errors import RunError
from poise.model.robot import Robot
from poise.session.callbacks import Say
from poise.session.launch.emulated_agents import agent_of, emulated_agents
from poise.wire.control_session import LEASE, locator
from poise.wire.heartbeats import UNCUT_LEASE
from poise.wire.records.status_records import SAMPLE_EVERY

_TOLERATED = 0.1
"""A run is invalid when the host starved computers for more than this share of it."""


class Computers:
    """The computers of a run, with the zenoh endpoints of their agents."""

    def __init__(
        self,
        endpoints: Mapping[str, str],
        without: tuple[str, ...] = (),
        agents: Mapping[str, subprocess.Popen[bytes]] | None = None,
        emulated: Mapping[str, EmulatedComputer] | None = None,
    ) -> None:
        self.endpoints = endpoints
        self.emulated = emulated or {}
        self._agents = agents or {}
        self.lease = UNCUT_LEASE if agents else LEASE
        self.without = without
        self._watch: StarvationWatch | None = None
        self._clock = SystemClock()
        self._began = 0.0

    @property
    def outlive_manager(self) -> bool:
        """Whether agents and containers go on when this process is killed."""
        return not self._agents

    @property
    def faster(self) -> Mapping[str, float]:
        """Computer -> how many times more CPU it has than the robot file says."""
        return {name: computer.slowdown for name, computer in self.emulated.items()}

    def raise_if_ended(self) -> None:
        """Raise RunError when an agent ended by itself: one that is killed restarts."""
        for name, process in self._agents.items():
            if (code := process.poll()) is not None and code >= 0:
                raise RunError(f"the agent of '{name}' ended with exit code {code}")

    def begin(self) -> None:
        """Judge from now on whether the host gives what the emulation promised."""
        self._began = self._clock.now()
        if self.emulated:
            self._watch = StarvationWatch(self.emulated, self._clock)

    def look(self) -> None:
        """Judge the moment; call it a few times a second."""
        if self._watch is not None:
            self._watch.look()

    def end(self, of: str | None = None) -> str:
        """Return why the run, or computer `of` in it, is invalid; empty: it is not."""
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
    robot: Robot,
    folder: Path,
    say: Say,
    sample_every: float = SAMPLE_EVERY,
    *,
    use_kept: bool = False,
) -> Iterator[Computers]:
    """Give the robot's real computers, or emulate all of them on this one."""
    addresses = {c.name: c.address for c in robot.computers if c.address}
    if addresses:
        yield Computers({n: locator(Endpoint.parse(a)) for n, a in addresses.items()})
        return
    kept = set_for(robot) if use_kept else None
    if kept is not None:
        with _kept(kept, say) as computers:
            yield computers
        return
    with emulated_agents(robot, folder, say, sample_every=sample_every) as agents:
        yield Computers(
            agent_locators(agents.emulation.computers),
            agents.emulation.without,
            agents.processes,
            agents.emulation.computers,
        )


@contextlib.contextmanager
def _kept(kept: EmulatedSet, say: Say) -> Iterator[Computers]:
    """Use computers that another process keeps, and leave them up."""
    state, keeper = kept.state(), kept.layout.owner.pid
    say(f"using the emulated computers that process {keeper} keeps")
    for fault in state.faults:
        say(f"  {fault}")
    try:
        yield Computers(
            agent_locators(kept.computers), state.without, emulated=kept.computers
        )
    finally:
        for computer in kept.computers.values():
            computer.end_started()


def agent_locators(computers: Mapping[str, EmulatedComputer]) -> dict[str, str]:
    """Return the zenoh endpoints of the agents of emulated computers."""
    return {name: locator(agent_of(computer)) for name, computer in computers.items()}
