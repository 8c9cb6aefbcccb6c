"""The emulated computers of a robot that a process keeps, and faults to rehearse there.

Any process of the user finds the set and the faults in force in the registry, and acts
on its namespaces and processes itself.
"""

from __future__ import annotations

import math
import os
import signal
import subprocess
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from msgspec.structs import replace

from poise.clock import wall_time
from poise.emulate import emulated_network, processes, registry
from poise.emulate.cpu_load import background_load
from poise.emulate.emulated_network import NetworkPlan, Shape
from poise.emulate.emulation import EmulatedComputer
from poise.emulate.registry import EmulationLayout, FaultKind, InjectedFault, KeptSet
from poise.errors import UsageError
from poise.kernel_counters import process_stat
from poise.model.robot import Robot
from poise.threads import poll_until

BOOT_LIMIT = 10.0
"""A computer's agent is started again within this time [s]."""
STOP_LIMIT = 30.0
"""A set is gone within this time after SIGTERM to its keeper [s]."""
_POLL_EVERY = 0.02


class EmulatedSet:
    """The emulated computers of a robot that a process keeps.

    A fault is in force until it is healed or the set ends, even after the process that
    injected it has ended. Every method raises `UsageError` for unknown names, for a
    fault that is in force already or not at all, and when the set has ended.
    """

    def __init__(self, layout: EmulationLayout, kept: KeptSet) -> None:
        self.layout = layout
        self.robot = kept.robot
        self.computers: Mapping[str, EmulatedComputer] = {
            computer.name: EmulatedComputer(computer) for computer in layout.computers
        }

    def state(self) -> KeptSet:
        """Return its state, with the faults in force; UsageError when it has ended."""
        now = registry.read(self.layout.run)
        if now is None or now.kept is None:
            message = f"the emulated computers of robot '{self.robot}' have ended"
            raise UsageError(message)
        return now.kept

    def is_down(self, computer: str) -> bool:
        """Return whether a computer was crashed or frozen, and not booted since."""
        return any(
            fault.kind in {"crashed", "frozen"} and fault.on == (computer,)
            for fault in self.state().faults
        )

    def cut(self, computer: str, other: str | None = None) -> None:
        """Cut two computers from each other, or one from all and from the manager.

        Packets vanish; no connection is reset.
        """
        on = self._named(computer, other)
        with self._changing() as faults:
            _raise_if_crashed(faults, on)
            _add(faults, InjectedFault(kind="cut", on=on, since=wall_time()))
            if other is None:
                emulated_network.detach(self._network(), self._index(computer))
            else:
                one, two = map(self._index, on)
                emulated_network.cut(self._network(), one, two)

    def slow(
        self,
        computer: str,
        other: str,
        *,
        bandwidth: float | None = None,
        latency: float | None = None,
    ) -> None:
        """Slow a link down: bandwidth [bytes/s] each way, latency [s] one way."""
        on = self._named(computer, other)
        if bandwidth is None and latency is None:
            raise UsageError("slow: give a bandwidth or a latency")
        if bandwidth is not None and not 1 <= bandwidth < math.inf:
            raise UsageError(
                f"slow: {bandwidth:g} B/s is not a bandwidth: give 1 or more"
            )
        if latency is not None and not 0 <= latency < math.inf:
            raise UsageError(f"slow: {latency:g} s is not a latency: give 0 or more")
        with self._changing() as faults:
            before = _find(faults, "slow", on)
            if before is None or before.shape is None:
                shape = self._link(on)
            else:
                shape = before.shape
                faults.remove(before)
            if bandwidth is not None:
                shape = replace(shape, bandwidth=bandwidth)
            if latency is not None:
                shape = replace(shape, latency=latency)
                if not emulated_network.can_delay(self._network().switch):
                    raise UsageError(
                        "slow: this kernel cannot delay packets (no sch_netem): give a "
                        "bandwidth only"
                    )
            self._reshape(on, shape)
            now = wall_time()
            _add(faults, InjectedFault(kind="slow", on=on, since=now, shape=shape))

    def heal(self, computer: str, other: str | None = None) -> None:
        """End what `cut` and `slow` did to two computers, or `cut` to one."""
        on = self._named(computer, other)
        with self._changing() as faults:
            _raise_if_crashed(faults, on)
            cut, slow = _drop(faults, "cut", on), _drop(faults, "slow", on)
            if cut is None and slow is None:
                raise UsageError(f"{_both(on)} is neither cut nor slow{_said(faults)}")
            if cut is not None and other is None:
                emulated_network.attach(self._network(), self._index(computer))
            elif cut is not None:
                one, two = map(self._index, on)
                emulated_network.join(self._network(), one, two)
            if slow is not None:
                self._reshape(on, self._link(on))

    def crash(self, computer: str) -> None:
        """Kill all processes of a computer at once, and cut its cable."""
        on = self._named(computer)
        with self._changing() as faults:
            _add(faults, InjectedFault(kind="crashed", on=on, since=wall_time()))
            if self.layout.network is not None:
                emulated_network.detach(self.layout.network, self._index(computer))
            processes.stop(self.computers[computer].running, ask=0.0)
            kinds: tuple[FaultKind, ...] = ("cut", "frozen", "frozen agent", "load")
            for kind in kinds:
                _drop(faults, kind, on)

    def freeze(self, computer: str, *, agent: bool = False) -> None:
        """Stop all processes of a computer, or its agent only, until it is booted."""
        on = self._named(computer)
        running = self.computers[computer].running
        with self._changing() as faults:
            _raise_if_crashed(faults, on)
            kind: FaultKind = "frozen agent" if agent else "frozen"
            _add(faults, InjectedFault(kind=kind, on=on, since=wall_time()))
            if agent:
                keeper = self.layout.owner.pid
                agents = [pid for pid in running() if _is_agent(pid, keeper)]
                if not agents:
                    raise UsageError(f"'{computer}' has no agent now: try again")
                processes.freeze(lambda: agents)
            else:
                processes.freeze(running)

    def boot(self, computer: str) -> None:
        """Bring a crashed or frozen computer back, or its frozen agent."""
        on = self._named(computer)
        running = self.computers[computer].running
        with self._changing() as faults:
            crashed = _drop(faults, "crashed", on)
            kinds: tuple[FaultKind, ...] = ("frozen", "frozen agent")
            frozen = [_drop(faults, kind, on) for kind in kinds]
            if crashed is None and not any(frozen):
                text = f"'{computer}' is neither crashed nor frozen{_said(faults)}"
                raise UsageError(text)
            if crashed is not None and self.layout.network is not None:
                emulated_network.attach(self.layout.network, self._index(computer))
            processes.thaw(running())
        what = f"the agent of '{computer}' did not start within {BOOT_LIMIT:g} s"
        deadline = time.monotonic() + BOOT_LIMIT  # its keeper starts it
        poll_until(lambda: bool(running()), deadline, what, _POLL_EVERY)

    def load(self, computer: str, cpu: float) -> None:
        """Let a program take `cpu` [host cores] on a computer; 0 ends it."""
        on = self._named(computer)
        most = self.computers[computer].limits.quota
        if not 0 <= cpu <= most:
            text = f"load of {cpu:g}: '{computer}' has {most:g} cores; 0 ends a load"
            raise UsageError(text)
        with self._changing() as faults:
            _raise_if_crashed(faults, on)
            before = _drop(faults, "load", on)
            if before is None and not cpu:
                raise UsageError(f"'{computer}' has no load{_said(faults)}")
            if before is not None:
                self._end(computer, before.processes)
            if cpu:
                pids, now = self._burn(computer, cpu), wall_time()
                _add(
                    faults,
                    InjectedFault(
                        kind="load", on=on, since=now, cpu=cpu, processes=pids
                    ),
                )

    def stop(self) -> None:
        """End the process that keeps the set, and wait until both are gone."""
        keeper = self.layout.owner
        if keeper.is_alive():
            os.kill(keeper.pid, signal.SIGTERM)
        what = f"process {keeper.pid} still keeps them {STOP_LIMIT:g} s after SIGTERM"
        deadline = time.monotonic() + STOP_LIMIT
        poll_until(lambda: not keeper.is_alive(), deadline, what, _POLL_EVERY)

    def _named(self, computer: str, other: str | None = None) -> tuple[str, ...]:
        on = (computer,) if other is None else (computer, other)
        for name in on:
            if name not in self.computers:
                names = ", ".join(self.computers)
                raise UsageError(
                    f"robot '{self.robot}' has no computer '{name}' (it has: {names})"
                )
        if computer == other:
            raise UsageError(f"'{computer}' is named twice: name two computers")
        return on

    def _index(self, computer: str) -> int:
        return list(self.computers).index(computer)

    @contextmanager
    def _changing(self) -> Iterator[list[InjectedFault]]:
        """Give the faults in force; what is changed is written, unless it fails."""
        with registry.locked():
            state = self.state()
            faults = list(state.faults)
            yield faults
            kept = replace(state, faults=tuple(faults))
            registry.write(replace(self.layout, kept=kept))

    def _network(self) -> NetworkPlan:
        if self.layout.network is None:
            raise UsageError(
                "this machine does not emulate the network: without "
                f"{self.state().no_network}"
            )
        return self.layout.network

    def _link(self, on: tuple[str, ...]) -> Shape:
        """Return how the robot file wants a link."""
        for first, second, shape in self._network().links:
            if set(map(self._index, on)) == {first, second}:
                return shape
        raise UsageError(
            f"{_both(on)} has no link that could be slow: declare it under `links` in "
            "the robot file"
        )

    def _reshape(self, on: tuple[str, ...], shape: Shape) -> None:
        network = self._network()
        one, two = map(self._index, on)
        delays = shape.latency > 0 and emulated_network.can_delay(network.switch)
        emulated_network.reshape(network, one, two, shape, delays=delays)

    def _burn(self, computer: str, cpu: float) -> tuple[int, ...]:
        """Start what takes CPU, a process for each core; return their numbers."""
        count = math.ceil(cpu)
        argv, null = background_load(cpu / count), subprocess.DEVNULL
        popen = self.computers[computer].popen
        # who reads what this process prints must not wait for the load to end
        starts = (
            popen(argv, stdin=null, stdout=null, stderr=null) for _ in range(count)
        )
        return tuple(child.pid for child in starts)

    def _end(self, computer: str, pids: tuple[int, ...]) -> None:
        running = self.computers[computer].running  # or their numbers are others'
        processes.stop(lambda: sorted(set(pids) & set(running())), ask=0.0)


def _is_agent(pid: int, keeper: int) -> bool:
    """Return whether this is an agent or witness: containers have the same words."""
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
    except (FileNotFoundError, ProcessLookupError):  # it has ended
        return False
    stat = process_stat(pid)
    is_child = stat is not None and stat.parent == keeper
    return is_child and words[2:4] in ([b"poise", b"agent"], [b"poise", b"witness"])


def _find(
    faults: list[InjectedFault], kind: FaultKind, on: tuple[str, ...]
) -> InjectedFault | None:
    return next((f for f in faults if f.kind == kind and set(f.on) == set(on)), None)


def _drop(
    faults: list[InjectedFault], kind: FaultKind, on: tuple[str, ...]
) -> InjectedFault | None:
    fault = _find(faults, kind, on)
    if fault is not None:
        faults.remove(fault)
    return fault


def _add(faults: list[InjectedFault], fault: InjectedFault) -> None:
    before = _find(faults, fault.kind, fault.on)
    if before is not None:
        raise UsageError(f"there is already: {before}; {before.way_out}")
    faults.append(fault)


def _raise_if_crashed(faults: list[InjectedFault], on: tuple[str, ...]) -> None:
    for name in on:
        if _find(faults, "crashed", (name,)) is not None:
            raise UsageError(f"'{name}' is crashed: `poise emulate boot {name}` first")


def _both(on: tuple[str, ...]) -> str:
    return "-".join(f"'{name}'" for name in on)


def _said(faults: list[InjectedFault]) -> str:
    known = "; ".join(f"{fault}: {fault.way_out}" for fault in faults)
    return f" (in force: {known or 'nothing'})"


def find_set(robot: str | None = None) -> EmulatedSet:
    """Return the emulated computers that a process of this user keeps."""
    sets = {kept.robot: kept for kept in all_sets()}
    if robot is None and len(sets) == 1:
        return next(iter(sets.values()))
    if robot in sets:
        return sets[robot]
    names = ", ".join(sets) or "none"
    if robot is None and sets:
        raise UsageError(
            f"several robots have emulated computers ({names}): name one with --robot"
        )
    whose = f"robot '{robot}' has" if robot else "there are"
    raise UsageError(
        f"{whose} no emulated computers that are kept (up: {names}); "
        "`poise emulate FILE` brings them up"
    )


def set_for(robot: Robot) -> EmulatedSet | None:
    """Return the set that a robot is to use; None when none is kept for it."""
    for kept in all_sets():
        if kept.robot != robot.name:
            continue
        if kept.state().hardware == KeptSet.of(robot).hardware:
            return kept
        raise UsageError(
            f"process {kept.layout.owner.pid} keeps emulated computers of robot "
            f"'{robot.name}' ({', '.join(kept.computers)}) that are not those of this "
            f"robot file: `poise emulate stop --robot {robot.name}` ends them; "
            "then `poise emulate FILE` brings these up"
        )
    return None


def all_sets() -> list[EmulatedSet]:
    """Return all sets that processes of this user keep."""
    return [
        EmulatedSet(layout, kept)
        for layout in registry.registered()
        if (kept := layout.kept) and kept.since and layout.owner.is_alive()
    ]
