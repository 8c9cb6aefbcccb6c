"""Breaks a running robot at random, and looks whether it comes back each time.

Containers, agents and managers are killed, links cut and slowed, computers crashed,
frozen and loaded, components moved. Then all is healed; within a limit the robot has to
be as its file says, with nothing active twice and no process left over. Its components
number all they say: nothing may come twice or in another order.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from msgspec import Struct

import poise
from poise.errors import PoiseError, UsageError
from poise.session.running_robots.running import Running, Status
from poise.wire.records.status import ComponentStatus

ROBOT = Path(__file__).parent / "robot" / "robot.yaml"
COMPONENTS = ("caller", "counter", "relay", "sensor", "sink", "source")
COMPUTERS = ("a", "b", "c")
UP_LIMIT = 30.0
"""A manager has started within this time [s]."""
SETTLE_LIMIT = 60.0
"""A healed robot is as its file says within this time [s]."""
ROUND = (4.0, 10.0)
"""Faults come for so long before all is healed [s]."""
STAYS = 2.0
"""It must stay so for this time [s]."""
FLOWS = (("sink", "received"), ("caller", "received"), ("caller", "answered"))
PAUSE = (0.1, 1.5)
"""From one fault to the next [s]."""
AT_ONCE = 2
"""At most so many faults that last are in force."""
WARM = 180.0
"""A process's memory is compared from this age on [s]."""
_LOOK = 0.1


class ChaosReport(Struct, kw_only=True):
    """What was done to a robot, and what came of it.

    Parameters
    ----------
    events
        What was done -> how often.
    trouble
        What must not be: what hung, was active twice, was left over, came twice or in
        another order.
    settled
        How long each healed robot took to be as its file says [s].
    received, lost, doubled, reordered
        Messages, over all receivers.
    answered, refused
        Calls.
    growth, grew
        The most by which the memory of a process grew after `WARM` [bytes], and which.
    """

    events: Counter[str]
    trouble: list[str]
    settled: list[float]
    received: int = 0
    lost: int = 0
    doubled: int = 0
    reordered: int = 0
    answered: int = 0
    refused: int = 0
    growth: int = 0
    grew: str = "no process"


class Chaos:
    """A robot that is broken at random, with its manager in a process of its own.

    Parameters
    ----------
    folder
        For the manager's journal and output.
    say
        Takes a sentence at every event.
    """

    def __init__(
        self, folder: Path, chance: random.Random, say: Callable[[str], object]
    ) -> None:
        self._folder = folder
        self._chance = chance
        self._say = say
        self._running = Running("chaos")
        self._lasting: dict[str, Callable[[], object]] = {}
        self._moves: list[subprocess.Popen[bytes]] = []
        self._measures: dict[tuple[str, int, int], dict[str, float]] = {}
        self._memory: dict[int, tuple[str, int, int]] = {}
        self.report = ChaosReport(events=Counter(), trouble=[], settled=[])

    @contextlib.contextmanager
    def begun(self) -> Iterator[None]:
        """Emulate the computers and start the manager; end both afterwards."""
        robot = poise.load(ROBOT)
        with poise.emulated(robot, say=lambda _: None) as self._computers:
            self._manager = self._start_manager()
            try:
                self._settle()
                yield
            finally:
                self._heal()
                self._manager.send_signal(signal.SIGTERM)
                for process in (self._manager, *self._moves):
                    process.wait(SETTLE_LIMIT)

    def go(self, seconds: float) -> None:
        """Break the robot again and again for a time [s], or until it stays broken."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and not self.report.trouble:
            until = time.monotonic() + self._chance.uniform(*ROUND)
            while time.monotonic() < until:
                self._break_something()
                self._look_for(self._chance.uniform(*PAUSE))
            self._heal()
            self._settle()

    def _break_something(self) -> None:
        momentary = [
            self._kill_container,
            self._kill_agent,
            self._kill_manager,
            self._move,
        ]
        lasting = [
            self._cut,
            self._cut_off,
            self._slow,
            self._crash,
            self._freeze,
            self._load,
        ]
        if len(self._lasting) >= AT_ONCE:
            self._end_one(self._chance.choice(self._mendable()))
        else:
            event = self._chance.choice([*momentary, *momentary, *lasting])
            with contextlib.suppress(UsageError):  # such as two faults of one link
                name = event()
                self._note(name)

    def _note(self, event: str) -> None:
        self.report.events[event.partition(" ")[0]] += 1
        self._say(event)

    def _kill_container(self) -> str:
        status = self._status()
        pids = [
            (container.name, container.pid)
            for computer in (status.computers.values() if status else ())
            for container in computer.containers
        ]
        if not pids:
            raise UsageError("there is no container")
        name, pid = self._chance.choice(pids)
        _kill(pid)
        return f"container {name} killed"

    def _kill_agent(self) -> str:
        computer = self._chance.choice(COMPUTERS)
        status = self._status()
        if status is None or computer not in status.computers:
            raise UsageError("its process is not known")
        _kill(status.computers[computer].pid)
        return f"agent of {computer} killed"

    def _kill_manager(self) -> str:
        self._manager.kill()
        self._manager.wait()
        self._look_for(self._chance.uniform(0, 2))
        self._manager = self._start_manager()
        return "manager killed"

    def _move(self) -> str:
        component = self._chance.choice(COMPONENTS)
        computer = self._chance.choice(COMPUTERS)
        self._moves = [each for each in self._moves if each.poll() is None]
        self._moves.append(
            subprocess.Popen(
                [sys.executable, "-m", "poise", "move", component, computer],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
        )
        return f"move of {component} to {computer}"

    def _cut(self) -> str:
        one, two = self._chance.sample(COMPUTERS, 2)
        self._computers.cut(one, two)
        return self._lasts(
            f"cut of {one} and {two}", lambda: self._computers.heal(one, two)
        )

    def _cut_off(self) -> str:
        computer = self._chance.choice(COMPUTERS)
        self._computers.cut(computer)
        return self._lasts(
            f"cut-off of {computer}", lambda: self._computers.heal(computer)
        )

    def _slow(self) -> str:
        one, two = self._chance.sample(COMPUTERS, 2)
        self._computers.slow(one, two, bandwidth=self._chance.choice([2e4, 1e6]))
        return self._lasts(
            f"slow link {one} {two}", lambda: self._computers.heal(one, two)
        )

    def _crash(self) -> str:
        computer = self._chance.choice(COMPUTERS)
        self._computers.crash(computer)
        return self._lasts(
            f"crash of {computer}", lambda: self._computers.boot(computer)
        )

    def _freeze(self) -> str:
        computer = self._chance.choice(COMPUTERS)
        self._computers.freeze(computer)
        return self._lasts(
            f"freeze of {computer}", lambda: self._computers.boot(computer)
        )

    def _load(self) -> str:
        computer = self._chance.choice(COMPUTERS)
        self._computers.load(computer, 0.3)
        return self._lasts(
            f"load on {computer}", lambda: self._computers.load(computer, 0)
        )

    def _lasts(self, event: str, end: Callable[[], object]) -> str:
        self._lasting[event] = end
        return event

    def _end_one(self, event: str) -> None:
        end = self._lasting.pop(event)
        with contextlib.suppress(UsageError):  # a crash has ended it already
            end()
        self._say(f"  no more: {event}")

    def _mendable(self) -> list[str]:
        """Return what can be mended: cables only where no computer is crashed."""
        events = list(self._lasting)
        return [each for each in events if each.startswith("crash")] or events

    def _heal(self) -> None:
        while self._lasting:
            self._end_one(self._mendable()[0])

    def _settle(self) -> None:
        """Wait until all is well and stays so for a while; note what is not."""
        began = well = time.monotonic()
        before = self._flows()
        while True:
            self._look_for(_LOOK)
            wrong, now = self._wrong(), time.monotonic()
            if not wrong and now - well >= STAYS:
                wrong = [
                    f"'{name}' has {what} nothing for {STAYS:g} s"
                    for (name, what), value in self._flows().items()
                    if value <= before[name, what]
                ]
                if not wrong:
                    self.report.settled.append(well - began)
                    self._weigh()
                    return
            if wrong:
                if now - began > SETTLE_LIMIT:
                    said = f"{SETTLE_LIMIT:g} s after all was healed"
                    self.report.trouble += [f"{said}: {what}" for what in wrong]
                    return
                well, before = now, self._flows()

    def _flows(self) -> dict[tuple[str, str], float]:
        """Return what was received and answered, as the active components say."""
        found = dict.fromkeys(FLOWS, 0.0)
        for _, component in self._components():
            if component.state == "active":
                for what, summary in component.measures.items():
                    if (component.name, what) in found:
                        found[component.name, what] = summary.maximum
        return found

    def _components(self) -> Iterator[tuple[int, ComponentStatus]]:
        """Yield all components with their process's number."""
        status = self._status()
        for computer in status.computers.values() if status else ():
            for container in computer.containers:
                for component in container.components:
                    yield container.pid, component

    def _wrong(self) -> list[str]:
        """Return what is not as the robot's file says."""
        if self._manager.poll() is not None:
            code = self._manager.returncode
            return [f"the manager ended by itself (exit code {code})"]
        status = self._status()
        if status is None:
            return ["the manager does not answer"]
        active = Counter(
            component.name
            for computer in status.computers.values()
            for container in computer.containers
            for component in container.components
            if component.state == "active"
        )
        wrong = [deviation.what for deviation in status.deviations]
        wrong += [
            f"'{name}' is active {active[name]} times"
            for name in COMPONENTS
            if active[name] != 1
        ]
        for name, computer in status.computers.items():
            known = {container.pid for container in computer.containers}
            # beside containers: agent, its zygote, and zygotes of adopted containers
            left = [
                pid
                for pid in self._computers.computers[name].running()
                if pid not in {computer.pid, *known, *map(_parent, known)}
                and _parent(pid) != computer.pid
            ]
            if left:
                wrong.append(f"left over on '{name}': {_described(left)}")
        return wrong

    def _look_for(self, seconds: float) -> None:
        """Take in what components tell, for a time [s]."""
        end = time.monotonic() + seconds
        while True:
            self._take_in()
            left = end - time.monotonic()
            if left <= 0:
                return
            time.sleep(min(left, _LOOK))

    def _take_in(self) -> None:
        for pid, component in self._components():
            values = {n: s.maximum for n, s in component.measures.items()}
            key = component.name, component.epoch, pid
            self._measures.setdefault(key, {}).update(values)

    def finish(self) -> ChaosReport:
        """Add up what the components told, and return all."""
        report = self.report
        # what moves takes its counts along
        lives: dict[tuple[str, float], dict[str, float]] = {}
        for (name, epoch, pid), values in self._measures.items():
            life = lives.setdefault((name, values.get("born", epoch + pid)), {})
            for what, value in values.items():
                life[what] = max(life.get(what, 0.0), value)
        totals = Counter[str]()
        for life in lives.values():
            totals.update({what: int(value) for what, value in life.items()})
        for what in ("received", "lost", "doubled", "reordered", "answered", "refused"):
            setattr(report, what, totals[what])
        for what in ("doubled", "reordered"):
            if totals[what]:
                report.trouble.append(f"{totals[what]} messages {what}")
        for what, first, last in self._memory.values():
            if last - first > report.growth:
                report.growth, report.grew = last - first, what
        return report

    def _weigh(self) -> None:
        """Note what memory the processes have for themselves."""
        pids = [self._manager.pid]
        for computer in self._computers.computers.values():
            pids += computer.running()
        for pid in pids:
            with contextlib.suppress(OSError):
                age = time.time() - Path(f"/proc/{pid}").stat().st_ctime
                if age > WARM or pid in self._memory:
                    now = _private_memory(pid)
                    first = self._memory.get(pid, ("", now, now))[1]
                    self._memory[pid] = _described([pid]), first, now

    def _status(self) -> Status | None:
        try:
            return self._running.status()
        except PoiseError:
            return None

    def _start_manager(self) -> subprocess.Popen[bytes]:
        with (self._folder / "manager.log").open("ab") as log:
            return subprocess.Popen(
                [
                    *(sys.executable, "-m", "poise", "up", str(ROBOT)),
                    *("--journal", str(self._folder / "journal.jsonl")),
                ],
                stdout=log,
                stderr=log,
            )


def _kill(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


def _parent(pid: int) -> int:
    """Return a process's parent; 0: it has ended."""
    try:
        words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2]
    except OSError:
        return 0
    return int(words.split()[1])


def _private_memory(pid: int) -> int:
    """Return the memory that only this process has [bytes]."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return sum(int(x.split()[1]) << 10 for x in lines if x.startswith("Private"))


def _described(pids: Iterable[int]) -> str:
    found = []
    for pid in sorted(pids):
        with contextlib.suppress(OSError):
            words = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
            found.append(f"{pid} ({b' '.join(words).decode()[-80:]})")
    return "; ".join(found) or "nothing"
