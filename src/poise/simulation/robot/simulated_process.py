"""The processes of a simulated computer, and the clocks that they read."""

from __future__ import annotations

import time
from collections.abc import Callable
from math import inf
from random import Random

from poise.simulation.scheduler import (
    Scheduler,
    SimulatedTask,
    SimulatedTimer,
    SimulationError,
)

FIRST_PID = 10_000_000
"""No real process has such a number (Linux: 4,194,304 at most)."""


class TaskFailed(SimulationError):
    """Code under test raised an error that none of its own code caught."""

    def __init__(self, task: SimulatedTask, error: BaseException) -> None:
        super().__init__(f"{task}: {type(error).__name__}: {error}")
        self.error = error


class SimulatedComputer:
    """A simulated computer: its clocks and its processes.

    `boot`: what its monotonic clock shows when the run begins [s].
    `drift`: how much quicker its clocks run than virtual time [s/s].
    `cores`, `speed`: of its CPU.
    `wall_ahead`: how far its wall clock is ahead of true time; a fault steps it [s].
    `pauses`: for each fault that stops the whole computer now, what it stopped.
    """

    EPOCH = 1_767_225_600.0
    """The wall clocks begin here: 2026 [s since 1970]."""

    def __init__(
        self,
        scheduler: Scheduler,
        name: str,
        boot: float = 0.0,
        drift: float = 0.0,
        cores: float = 4.0,
        speed: float = 1.0,
        *,
        is_emulated: bool = False,
    ) -> None:
        self.scheduler = scheduler
        self.name = name
        self.cpu = scheduler.engine.cpu(cores, speed, is_emulated=is_emulated)
        self.wall_ahead = 0.0
        self.processes: dict[int, Process] = {}
        self.pauses: list[list[Process]] = []
        self._boot = boot
        self._rate = 1.0 + drift
        self._asleep = 0.0
        self._suspended_at: float | None = None
        self._wakes_at = 0.0
        self._num_off = 0
        self._when_on: list[Callable[[], object]] = []

    def monotonic(self) -> float:
        """Return CLOCK_MONOTONIC [s], which stands while the computer is suspended."""
        return self._boot + self.scheduler.now * self._rate - self._asleep

    def boottime(self) -> float:
        """Return CLOCK_BOOTTIME [s]."""
        return self._boot + self.scheduler.now * self._rate

    def asleep(self) -> float:
        """Return for how long it has been suspended [s]."""
        return self.boottime() - self.monotonic()

    def moment_of(self, boottime: float) -> float:
        """Return when CLOCK_BOOTTIME shows so much [virtual s]."""
        return (boottime - self._boot) / self._rate

    def wall(self) -> float:
        """Return the wall clock [s since 1970]."""
        return self.EPOCH + self.scheduler.now * self._rate + self.wall_ahead

    def start(self, name: str) -> Process:
        """Start a process; it has no task yet, and waits while all stands still."""
        pid = FIRST_PID + self.scheduler.number()
        process = Process(self, f"{self.name}/{name}", pid)
        self.processes[pid] = process
        if self._suspended_at is not None:
            process.pause()
        for stopped in self.pauses:
            process.pause()
            stopped.append(process)
        return process

    @property
    def is_off(self) -> bool:
        """Whether it has no power, so that nothing can start."""
        return self._num_off > 0

    def lose_power(self) -> None:
        """End all processes, until as many calls of `get_power` have come."""
        self._num_off += 1
        for process in list(self.processes.values()):
            process.kill()

    def get_power(self) -> None:
        """Have power again, unless something else still takes it."""
        self._num_off -= 1
        if not self.is_off:
            acts, self._when_on = self._when_on, []
            for act in acts:
                act()

    def when_on(self, act: Callable[[], object]) -> None:
        """Do something at once, or when there is power again."""
        if self.is_off:
            self._when_on.append(act)
        else:
            act()

    def suspend(self, seconds: float) -> None:
        """Let the whole computer stand still for a while [s], as in suspend to RAM."""
        now = self.scheduler.now
        if self._suspended_at is None:
            self._suspended_at = now
            for process in self.processes.values():
                process.pause()
        self._wakes_at = max(self._wakes_at, now + seconds)
        self.scheduler.at(now + seconds, self._wake)

    def _wake(self) -> None:
        now = self.scheduler.now
        if self._suspended_at is None or now < self._wakes_at:
            return
        self._asleep += (now - self._suspended_at) * self._rate
        self._suspended_at = None
        for process in list(self.processes.values()):
            process.resume()


class ProcessClock:
    """The `Clock` of a process: read far more often than all else of the library."""

    def __init__(self, computer: SimulatedComputer) -> None:
        self.now = computer.monotonic

    def sleep(self, seconds: float) -> None:
        """Let the task that runs wait [s]."""
        time.sleep(seconds)  # of `SimulatedLibrary`


class Process:
    """A process on a simulated computer.

    `random`: what its code draws from.
    `on_end`: called when it has ended, in order.
    `awake_since`: when it began, or its last pause ended [s].
    `died_at`: when it was killed or ended; infinite while it lives [s].
    `on_pause`: called when it is paused, or goes on, with whether it is.
    """

    def __init__(self, computer: SimulatedComputer, name: str, pid: int) -> None:
        self.computer = computer
        self.scheduler = computer.scheduler
        self.name = name
        self.pid = pid
        self.is_dead = False
        self.died_at = inf
        self.is_paused = False
        self._num_pauses = 0
        self.awake_since = self.scheduler.now
        self.held: list[SimulatedTask] = []
        self.on_end: list[Callable[[], object]] = []
        self.on_pause: Callable[[bool], object] = lambda _: None
        self.on_failure: Callable[[TaskFailed], object] | None = None
        self.random: Random = self.scheduler.choices.random(f"code/{name}/{pid}")
        self._tasks: dict[int, SimulatedTask] = {}
        self._late: list[Callable[[], object]] = []

    def after(self, seconds: float, act: Callable[[], object]) -> SimulatedTimer:
        """Let it do something after a time [s], or when it is not paused any more."""
        at = self.scheduler.now + seconds
        return self.scheduler.at(at, lambda: self.do(act))

    def do(self, act: Callable[[], object]) -> None:
        """Let it do something at once, or when it is not paused any more."""
        if self.is_paused:
            self._late.append(act)
        elif not self.is_dead:
            act()

    def spawn(self, name: str, work: Callable[[], object]) -> SimulatedTask:
        """Start a task of this process: its code runs on virtual time."""
        task = self.scheduler.spawn(self, name, work)
        if len(self._tasks) > 64:  # noqa: PLR2004, most tasks are short
            self._tasks = {n: t for n, t in self._tasks.items() if not t.has_ended}
        self._tasks[task.number] = task
        return task

    def pause(self) -> None:
        """Let it stand still, as SIGSTOP does, until each pause is resumed."""
        self._num_pauses += 1
        if self._num_pauses == 1:
            self.is_paused = True
            self.on_pause(True)

    def resume(self) -> None:
        """Let it go on, unless another pause lasts."""
        self._num_pauses -= 1
        if self._num_pauses:
            return
        self.is_paused, self.awake_since = False, self.scheduler.now
        self.on_pause(False)
        held, self.held = self.held, []
        for task in held:
            self.scheduler.resume(task)
        late, self._late = self._late, []
        for act in late:
            self.do(act)

    def kill(self) -> None:
        """End it at once, as SIGKILL does: not one of its statements runs any more."""
        if self.is_dead:
            return
        self.is_dead = True
        self.died_at = self.scheduler.now
        self.computer.processes.pop(self.pid, None)
        self.scheduler.at(self.scheduler.now, self._bury)

    def note_failure(self, task: SimulatedTask, error: BaseException) -> None:
        """Raise `TaskFailed` in the simulated world."""
        failure = TaskFailed(task, error)
        if self.on_failure is None:
            raise failure from error
        self.on_failure(failure)

    def _bury(self) -> None:
        for task in self._tasks.values():
            self.scheduler.end(task)
        for note in self.on_end:
            note()
