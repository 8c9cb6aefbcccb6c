"""Which containers do not respond, and why, with the kernel's counters made up."""

from __future__ import annotations

import os
from pathlib import Path
from typing import cast

from poise.kernel_counters import Processes
from poise.runtime._calls import PageSampler
from poise.runtime.supervision.health import CHECK_EVERY, Silence, Watchdog

PID = 7


class World(Processes):
    """One container; each step of time it runs, waits for a CPU, or does neither."""

    def __init__(self) -> None:
        self.now = 100.0
        self.beats = 1
        self.stopped = False
        self.ended = False
        self.debugger = 0
        self.used = 0.0
        self.waited = 0.0
        self.is_runnable = False
        self.dog = Watchdog(self, lambda: self.now)

    def is_stopped(self, pid: int) -> bool:
        assert pid == PID
        return self.stopped

    def tracer(self, pid: int) -> int:
        assert pid == PID
        return self.debugger

    def has_ended(self, pid: int) -> bool:
        assert pid == PID
        return self.ended

    def cpu(self, pid: int) -> float:
        assert pid == PID
        return self.used

    def delays(self, pid: int) -> dict[int, float]:
        return {pid: self.waited}

    def has_one_that_goes_on(self, pid: int) -> bool:
        assert pid == PID
        return self.is_runnable

    def heartbeat(self) -> int:
        return self.beats

    def go_on(
        self, seconds: float, *, beats: bool = False, cpu: float = 0, wait: float = 0
    ) -> list[Silence]:
        """Let time pass; `cpu` and `wait` are shares of it."""
        found: list[Silence] = []
        for _ in range(round(seconds / CHECK_EVERY)):
            self.now += CHECK_EVERY
            self.beats += beats
            self.used += cpu * CHECK_EVERY
            self.waited += wait * CHECK_EVERY
            found += self.dog.check([("c", PID, cast(PageSampler, self))])
        return found


def test_one_that_responds_is_not_mentioned() -> None:
    assert World().go_on(60.0, beats=True, cpu=0.1) == []


def test_a_stopped_process_is_noticed_within_a_second_and_once() -> None:
    world = World()
    world.go_on(1.0, beats=True)
    world.stopped = True
    (found,) = world.go_on(0.8)
    assert not found.is_starved
    assert "SIGSTOP" in found.reason
    assert str(PID) in found.remedy
    assert world.go_on(60.0) == []
    world.stopped = False
    (over,) = world.go_on(1.0, beats=True)
    assert over.reason == ""
    assert over.seconds > 60.0


def test_a_process_that_a_debugger_holds_is_not_told_to_be_continued() -> None:
    world = World()
    world.go_on(1.0, beats=True)
    world.stopped, world.debugger = True, 9
    (found,) = world.go_on(0.8)
    assert found.reason == "process 9 debugs it"
    assert "kill" not in found.remedy


def test_a_debugger_is_found(tmp_path: Path) -> None:
    (tmp_path / "7").mkdir()
    (tmp_path / "7" / "status").write_text("Name:\ta: b\nTracerPid:\t9\nUid:\t0\t0\n")
    assert Processes(tmp_path).tracer(7) == 9
    assert Processes(tmp_path).tracer(8) == 0
    assert Processes().tracer(os.getpid()) == 0


def test_one_that_has_ended_holds_no_interpreter() -> None:
    world = World()
    world.go_on(1.0, beats=True)
    world.ended = True
    assert world.go_on(60.0) == []


def test_an_interpreter_that_is_held_is_noticed_within_a_second() -> None:
    for cpu, how in ((1.0, "a thread holds"), (0.0, "a thread waits while it holds")):
        world = World()
        world.go_on(1.0, beats=True)
        (found,) = world.go_on(0.8, cpu=cpu)
        assert found.reason.startswith(how)


def test_a_container_that_gets_no_cpu_for_a_while_is_only_slow() -> None:
    world = World()
    world.go_on(1.0, beats=True)
    assert world.go_on(4.0, wait=0.9, cpu=0.1) == []
    assert world.go_on(1.0, beats=True) == []


def test_a_wait_for_a_cpu_that_is_not_over_is_no_held_interpreter() -> None:
    world = World()
    world.go_on(1.0, beats=True)
    world.is_runnable = True
    assert world.go_on(4.0) == []
    world.is_runnable = False
    assert world.go_on(1.0, beats=True) == []


def test_a_container_that_gets_no_cpu_for_long_does_not_respond() -> None:
    world = World()
    world.go_on(1.0, beats=True)
    (found,) = world.go_on(6.0, wait=1.0)
    assert found.reason == "it gets no CPU"


def test_an_interpreter_that_is_held_on_a_busy_machine_is_noticed_later() -> None:
    world = World()
    world.go_on(1.0, beats=True)
    (found,) = world.go_on(3.0, wait=0.5, cpu=0.5)
    assert "GIL" in found.reason
    assert found.seconds > 1.0


def test_a_watchdog_that_got_no_cpu_blames_nobody() -> None:
    world = World()
    world.go_on(1.0, beats=True)
    world.now += 10.0
    assert world.go_on(CHECK_EVERY) == []
    assert world.go_on(1.0, beats=True) == []


def test_a_container_that_only_starts_is_not_watched() -> None:
    world = World()
    world.beats = 0
    assert world.go_on(60.0) == []
