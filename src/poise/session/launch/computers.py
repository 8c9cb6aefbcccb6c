"""The robot's computers, up and with an agent each: real ones, or emulated here."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from ipaddress import ip_address
from pathlib import Path
from typing import Self

from poise import threads
from poise.clock import SystemClock
from poise.emulate import (
    EmulatedComputer,
    EmulatedSet,
    Emulation,
    StarvationWatch,
    find_set,
    set_for,
)
from poise.emulate.registry import locked
from poise.endpoint import AGENT_PORT, Endpoint
from poise.errors import PoiseError, RunError, UsageError
from poise.model.robot import Robot
from poise.runtime.agent.surroundings import BROKEN
from poise.session import Say, log
from poise.session.arguments import check_robot
from poise.session.folders import scratch_folder
from poise.session.launch.printer import STDERR, Printer, relay
from poise.threads import BackOff
from poise.units import counted
from poise.waker import Waker, wait_readable
from poise.wire.address import socket_path
from poise.wire.control_session import (
    SESSION_TIMEOUT,
    UNCUT_SESSION_TIMEOUT,
    endpoint_of,
    locator,
)
from poise.wire.credentials import Credentials, Role, find, raise_if_of_other_role
from poise.wire.records.status_records import SAMPLE_EVERY
from poise.wire.robots_here import AgentAddresses, forget

_KEYS = "keys"
"""The folder of keys, below that of an emulated computer, and beside those."""
ENCRYPT = "POISE_ENCRYPT"
"""Environment variable: not empty, connectors between emulated computers speak TLS, as
between real ones. Else the CPU time of encryption would not be that of a robot."""
_LOOK_EVERY = 0.02
"""While an agent has ended, it is looked whether it may start so often [s]."""


class EmulatedAgents:
    """The agents of emulated computers, as a context; those of a `kept` set restart."""

    def __init__(
        self,
        robot: Robot,
        emulation: Emulation,
        output: int,
        lifeline: int,
        sample_every: float,
        say: Say,
        kept: EmulatedSet | None,
    ) -> None:
        timeout = UNCUT_SESSION_TIMEOUT if kept is None else SESSION_TIMEOUT
        self.emulation = emulation
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self._robot = robot.name
        self._witnesses = {each.name for each in robot.computers if each.witness}
        self._output = output
        self._lifeline = lifeline
        self._session_timeout = f"{timeout}"
        self._options = ["--sample-every", f"{sample_every}", "--allow", "/"]
        if not os.environ.get(ENCRYPT):
            self._options.append("--plain-connectors")
        self._say = say
        self._kept = kept
        self._ended = {name: BackOff() for name in emulation.computers}
        self._down: set[str] = set()
        self._closing = Waker()
        self._keeper = threads.daemon(self._keep, "keeper", again=True)

    def __enter__(self) -> Self:
        self._issue_keys()
        for name in self.emulation.computers:
            self._start(name)
        self._keeper.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.wake()
        self._keeper.join()
        self._closing.close()

    def _issue_keys(self) -> None:
        """Let nobody else on this machine, or in its network, command the agents."""
        # `cryptography` is large, and real robots do not need it
        from poise.session.keys import init_keys  # noqa: PLC0415

        folders = {name: c.folder for name, c in self.emulation.computers.items()}
        authority = init_keys(self._robot, next(iter(folders.values())).parent / _KEYS)
        for name, folder in folders.items():
            issued = authority.issue(name, "agent", folder / _KEYS)
            authority.issue(name, "manager", issued.to_lead)

    def _start(self, name: str) -> None:
        computer = self.emulation.computers[name]
        is_witness = name in self._witnesses
        command = ["witness", name] if is_witness else ["agent", name, *self._options]
        argv = [sys.executable, "-m", "poise", *command, "--robot", self._robot]
        argv += ["--address", computer.address, "--folder", str(computer.folder)]
        argv += ["--keys", str(computer.folder / _KEYS)]
        argv += ["--session-timeout", self._session_timeout]
        self.processes[name] = computer.popen(
            [*argv, "--lifeline", str(self._lifeline)],
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=self._output,
            pass_fds=[self._lifeline],
        )

    def _keep(self) -> None:
        while not self._wait():
            for name, process in list(self.processes.items()):
                if process.poll() is not None:
                    self._look_after(name, process.returncode)

    def _wait(self) -> bool:
        """Wait until an agent has ended or may start; return whether all end."""
        with contextlib.ExitStack() as stack:
            fds = [self._closing.fileno()]
            for process in self.processes.values():
                if process.poll() is None:
                    fds.append(os.pidfd_open(process.pid))
                    stack.callback(os.close, fds[-1])
            limit = _LOOK_EVERY if len(fds) <= len(self.processes) else None
            return fds[0] in wait_readable(fds, limit)

    def _look_after(self, name: str, code: int) -> None:
        """Start an agent again that has ended, when it is time."""
        now, back_off = time.monotonic(), self._ended[name]
        if name not in self._down:
            self._down.add(name)
            back_off.note_end(now)
        if now < back_off.again_at:
            return
        try:
            with locked():  # or it might start while its computer is being crashed
                ended = 0 <= code != BROKEN  # as it was asked, or as it had to
                stays_down = self._kept.is_down(name) if self._kept else ended
                if stays_down:
                    return
                self._start(name)
        except (PoiseError, OSError) as error:
            back_off.note_end(now)
            self._say(f"the agent of '{name}' cannot be started again: {error}")
        else:
            self._down.discard(name)
            self._say(f"the agent of '{name}' ended ({code}) and is started again")


def outlive_manager(robot: Robot) -> bool:
    """Return whether a robot's computers go on when its manager ends."""
    return not robot.is_emulated or set_for(robot) is not None


@contextlib.contextmanager
def emulated_agents(
    robot: Robot,
    folder: Path,
    say: Say,
    *,
    sample_every: float = SAMPLE_EVERY,
    keep: bool = False,
) -> Iterator[EmulatedAgents]:
    """Emulate a robot's computers, with an agent each; `keep`: for others, too."""
    try:
        for computer in robot.computers:
            socket_path(folder / computer.name, "")
    except ValueError as error:
        raise UsageError(str(error).replace("TMPDIR, --folder", "TMPDIR")) from error
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
            kept = find_set(robot.name) if keep else None
            with EmulatedAgents(
                robot, emulation, output, lifeline, sample_every, say, kept
            ) as agents:
                yield agents
    finally:
        os.close(lifeline)
        os.close(held)


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
    check_robot(robot)
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
            forget(robot.name)  # components there end, with a manager or without


_TOLERATED = 0.1
"""A run is invalid when the host starved computers for more than this share of it."""


class Computers:
    """The computers of a run, and where their agents are."""

    def __init__(
        self,
        addresses: AgentAddresses,
        without: tuple[str, ...] = (),
        agents: Mapping[str, subprocess.Popen[bytes]] | None = None,
        emulated: Mapping[str, EmulatedComputer] | None = None,
    ) -> None:
        self.addresses = addresses
        self.endpoints = addresses.endpoints
        self.emulated = emulated or {}
        self._agents = agents or {}
        self.without = without
        self._watch: StarvationWatch | None = None
        self._clock = SystemClock()
        self._began = 0.0

    @property
    def outlive_process(self) -> bool:
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

    def why_silent(self, names: Iterable[str]) -> Mapping[str, str]:
        """Return computer -> why its agent does not answer; empty: unknown."""
        from poise.wire.refusal import why_all_refused  # noqa: PLC0415, `ssl` is slow

        agents = {name: endpoint_of(self.endpoints[name]) for name in names}
        return why_all_refused(agents, self.addresses.credentials())

    def begin(self, promised: Mapping[str, float] = {}) -> None:
        """Judge the host from now on; `promised`: computer -> cores, if not all."""
        self._began = self._clock.now()
        if self.emulated:
            for name, cores in promised.items():
                self.emulated[name].promised = cores
            self._watch = StarvationWatch(self.emulated, self._clock)

    def poll(self) -> None:
        """Judge the moment; call it a few times a second."""
        if self._watch is not None:
            self._watch.poll()

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
    """Give the robot's real computers, those that are kept, or emulate all here."""
    if not robot.is_emulated:
        yield Computers(real_agents(robot))
        return
    if use_kept and (kept := set_for(robot)) is not None:
        state = kept.state()
        say(f"using the emulated computers that process {kept.layout.owner.pid} keeps")
        for fault in state.faults:
            say(f"  {fault}")
        addresses = emulated_addresses(robot.name, kept.computers)
        try:
            yield Computers(addresses, state.without, emulated=kept.computers)
        finally:
            for computer in kept.computers.values():
                computer.end_started()
        return
    with emulated_agents(robot, folder, say, sample_every=sample_every) as agents:
        yield Computers(
            emulated_addresses(robot.name, agents.emulation.computers),
            agents.emulation.without,
            agents.processes,
            agents.emulation.computers,
        )


def real_agents(robot: Robot, *also: Role) -> AgentAddresses:
    """Return where a robot's own agents are, and keys of a manager, or of `also`."""
    where = {c.name: Endpoint.parse(c.address) for c in robot.computers if c.address}
    keys = None if robot.insecure else find(robot.name, "manager", *also)
    for name, endpoint in where.items():
        is_local = endpoint.is_ip and ip_address(endpoint.host).is_loopback
        if keys is None and not (robot.insecure or is_local):
            raise_if_of_other_role(robot.name, "manager", *also)
            raise UsageError(
                f"there are no keys for robot '{robot.name}', and whoever reaches "
                f"computer '{name}' ({endpoint}) could run code there: `poise keys "
                "init` and `poise keys issue` make keys; `insecure: true` in the robot "
                "file goes without"
            )
    endpoints = {name: locator(at, keys) for name, at in where.items()}
    return AgentAddresses(robot.name, endpoints, str(keys.folder) if keys else "")


def emulated_addresses(
    robot: str, computers: Mapping[str, EmulatedComputer]
) -> AgentAddresses:
    """Return where the agents of emulated computers are, and the keys for them."""
    keys = next(iter(computers.values())).folder.parent / _KEYS
    found = Credentials(keys) if keys.exists() else None
    endpoints = {
        name: locator(Endpoint(computer.address, AGENT_PORT), found)
        for name, computer in computers.items()
    }
    return AgentAddresses(robot, endpoints, str(keys) if found else "")
