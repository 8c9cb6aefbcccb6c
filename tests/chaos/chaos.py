"""Breaks a running robot at random, and looks whether it comes back each time.

Containers, agents, computers and managers are killed and stopped, links cut and slowed,
computers crashed and loaded, components moved, and a second manager starts on the other
side of a cut. Then all is healed; within a limit the robot has to be as its file says,
with nothing active twice and no process left over. Its components number all they say:
nothing may come twice or in another order. They log when their handlers run: no two
incarnations of one may work at the same time.
"""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import poise
from examples.demo.overlaps import overlaps, read_handler_log
from poise.errors import PoiseError
from poise.session.running_robots.running import Running, Status
from poise.wire.records.status_records import ComponentStatus
from tests.chaos.faults import COMPONENTS, Faults, containers
from tests.chaos.managers import Managers
from tests.chaos.report import MESSAGES, ChaosReport

ROBOT = Path(__file__).parent / "robot"
WRITER = Path(__file__).parents[2] / "examples/relay/handler_log.py"
SETTLE_LIMIT = 60.0
"""A healed robot is as its file says within this time [s]."""
ROUND = (4.0, 10.0)
"""Faults come for so long before all is healed [s]."""
HEAL_LIMIT = 60.0
"""The faults of a round are over within this time [s]."""
STAYS = 2.0
"""It must stay so for this time [s]."""
FLOWS = (("sink", "received"), ("caller", "received"), ("caller", "answered"))
PAUSE = (0.1, 1.5)
"""From one fault to the next [s]."""
WARM = 180.0
"""A process's memory is compared from this age on [s]."""
_LOOK = 0.1


class Chaos:
    """A robot that is broken at random, with its manager in a process of its own.

    Parameters
    ----------
    folder
        For a copy of the robot, and the managers' journals and output.
    seed
        Of what happens when.
    say
        Takes a sentence at every event, with the time since the beginning.
    """

    def __init__(self, folder: Path, seed: int, say: Callable[[str], object]) -> None:
        self._folder = folder
        self._chance = random.Random(seed)
        self._tell = say
        self._began = time.monotonic()
        self._name = f"chaos-{os.getpid()}"
        self._running = Running(self._name)
        self._measures: dict[tuple[str, int, int], dict[str, float]] = {}
        self._memory: dict[int, tuple[str, int, int]] = {}
        self.report = ChaosReport(seed=seed, events=Counter(), trouble=[], settled=[])

    @contextlib.contextmanager
    def begun(self) -> Iterator[None]:
        """Emulate the computers and start the manager; end both afterwards."""
        file = self._written()
        robot = poise.load(file)
        with poise.emulated(robot, say=lambda _: None) as self._computers:
            self._managers = Managers(file, self._folder)
            self._faults = Faults(
                self._name,
                self._computers,
                self._managers,
                self._status,
                self._chance,
                self._say,
            )
            try:
                self._settle()
                yield
            finally:
                self._heal()
                if trouble := self._managers.end():
                    self.report.trouble.append(trouble)
                self._faults.end_moves(SETTLE_LIMIT)
                self.report.trouble += self._faults.trouble

    def go(self, seconds: float) -> None:
        """Break the robot again and again for a time [s], or until it stays broken."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and not self.report.trouble:
            until = time.monotonic() + self._chance.uniform(*ROUND)
            while time.monotonic() < until:
                self._faults.inject()
                self._look_for(self._chance.uniform(*PAUSE))
            self._heal()
            self._settle()

    def _say(self, sentence: str) -> None:
        self._tell(f"{time.monotonic() - self._began:8.1f} s  {sentence}")

    def _written(self) -> Path:
        """Write the robot, whose name is of this process alone; return its file."""
        folder = Path(shutil.copytree(ROBOT, self._folder / "robot"))
        shutil.copy(WRITER, folder)
        (folder / "handler-log").mkdir()
        file = folder / "robot.yaml"
        file.write_text(file.read_text().replace("NAME", self._name, 1))
        return file

    def _heal(self) -> None:
        """Wait until the faults of this round are over."""
        limit = time.monotonic() + HEAL_LIMIT
        while self._faults.in_force():
            self._look_for(_LOOK)
            if time.monotonic() > limit:
                self.report.trouble.append(f"faults last for over {HEAL_LIMIT:g} s")
                return

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
                    self._say(f"  settled after {well - began:.1f} s")
                    self._weigh()
                    return
            if wrong:
                if now - began > SETTLE_LIMIT:
                    at = f"{now - self._began:.1f} s"
                    said = f"{at}: {SETTLE_LIMIT:g} s after all was healed"
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
        for container in containers(self._status()):
            for component in container.components:
                yield container.pid, component

    def _wrong(self) -> list[str]:
        """Return what is not as the robot's file says."""
        if (code := self._managers.first.poll()) is not None:
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
            self._faults.end_due()
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
        for what in (*MESSAGES, "answered", "refused"):
            setattr(report, what, totals[what])
        for what in ("doubled", "reordered", "beside"):
            if totals[what]:
                report.trouble.append(f"{totals[what]} messages {what}")
        logs = read_handler_log(self._folder / "robot" / "handler-log")
        report.judge(overlaps(logs), self._faults.history, self._began)
        report.events.update(fault.kind for fault in self._faults.history)
        for what, first, last in self._memory.values():
            if last - first > report.growth:
                report.growth, report.grew = last - first, what
        return report

    def _weigh(self) -> None:
        """Note what memory the processes have for themselves."""
        pids = [self._managers.first.pid]
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
