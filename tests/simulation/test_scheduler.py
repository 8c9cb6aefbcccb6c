"""Virtual time, and who runs next."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from poise.simulation.choices import Choices
from poise.simulation.robot.simulated_process import (
    Process,
    SimulatedComputer,
    TaskFailed,
)
from poise.simulation.scheduler import SLACK, Scheduler, SimulationError


@pytest.fixture
def process(scheduler: Scheduler) -> Process:
    return SimulatedComputer(scheduler, "a").start("program")


def test_jumps_over_time_in_which_nothing_happens(
    scheduler: Scheduler, process: Process
) -> None:
    woke: list[float] = []

    def sleep() -> None:
        scheduler.wait(3600.0)
        woke.append(scheduler.now)

    process.spawn("sleeper", sleep)
    scheduler.run(7200.0)
    assert woke == [pytest.approx(3600.0 + SLACK)]
    assert scheduler.now == 7200.0


def test_a_seed_decides_the_order_and_the_same_seed_decides_the_same() -> None:
    def order(seed: int) -> str:
        scheduler, found = Scheduler(Choices(seed)), ""
        process = SimulatedComputer(scheduler, "a").start("program")

        def note(name: str) -> Callable[[], None]:
            def work() -> None:
                nonlocal found
                found += name

            return work

        for name in "abcdef":
            process.spawn(name, note(name))
        scheduler.at(1.0, lambda: None)
        scheduler.run(0.5)
        return found

    assert order(7) == order(7)
    assert len({order(seed) for seed in range(20)}) > 10


def test_an_end_of_all_that_can_happen_is_an_error_that_names_who_waits(
    scheduler: Scheduler, process: Process
) -> None:
    process.spawn("reader", lambda: scheduler.wait(why="a message"))
    with pytest.raises(SimulationError, match=r"a/program/reader \(a message\)"):
        scheduler.run(1.0)


def test_a_loop_that_lets_no_time_pass_is_an_error(
    scheduler: Scheduler, process: Process, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("poise.simulation.scheduler._MOST_AT_ONCE", 100)

    def spin() -> None:
        while True:
            scheduler.wait(0)

    process.spawn("spinner", spin)
    with pytest.raises(SimulationError, match="without any time"):
        scheduler.run(1.0)


def test_not_one_statement_of_a_killed_process_runs(
    scheduler: Scheduler, process: Process
) -> None:
    seen: list[str] = []

    def work() -> None:
        try:
            scheduler.wait(1.0)
            seen.append("went on")
        except Exception:  # noqa: BLE001 - what no code under test may catch
            seen.append("caught")

    process.spawn("worker", work)
    scheduler.at(0.5, process.kill)
    scheduler.at(9.0, lambda: None)
    scheduler.run(5.0)
    assert seen == []


def test_an_error_that_nobody_catches_ends_the_run_and_names_the_task(
    scheduler: Scheduler, process: Process
) -> None:
    known: dict[str, str] = {}
    process.spawn("worker", lambda: known["missing"])
    with pytest.raises(TaskFailed, match="a/program/worker: KeyError: 'missing'"):
        scheduler.run(1.0)


def test_a_paused_process_goes_on_later(scheduler: Scheduler, process: Process) -> None:
    woke: list[float] = []

    def sleep() -> None:
        scheduler.wait(1.0)
        woke.append(scheduler.now)

    process.spawn("sleeper", sleep)
    scheduler.at(0.5, process.pause)
    scheduler.at(4.0, process.resume)
    scheduler.at(9.0, lambda: None)
    scheduler.run(5.0)
    assert woke == [4.0]


def test_the_monotonic_clock_stands_while_a_computer_is_suspended(
    scheduler: Scheduler,
) -> None:
    computer = SimulatedComputer(scheduler, "a", boot=100.0)
    scheduler.at(1.0, lambda: computer.suspend(3.0))
    scheduler.at(9.0, lambda: None)
    scheduler.run(6.0)
    assert computer.monotonic() == pytest.approx(103.0)
    assert computer.boottime() == pytest.approx(106.0)


def test_a_computer_that_is_suspended_twice_wakes_once(scheduler: Scheduler) -> None:
    computer = SimulatedComputer(scheduler, "a", boot=100.0)
    process, shown = computer.start("program"), []

    def look() -> None:
        while True:
            shown.append(computer.monotonic())
            scheduler.wait(0.1)

    process.spawn("reader", look)
    scheduler.at(1.0, lambda: computer.suspend(3.0))
    scheduler.at(2.0, lambda: computer.suspend(5.0))
    scheduler.run(9.0)
    assert shown == sorted(shown), "its clock never goes back"
    assert computer.monotonic() == pytest.approx(103.0)


def test_nothing_runs_on_a_suspended_computer(scheduler: Scheduler) -> None:
    computer, ran = SimulatedComputer(scheduler, "a"), []
    paused = computer.start("paused")
    paused.pause()
    computer.suspend(3.0)
    started = computer.start("started meanwhile")
    for process in (paused, started):
        process.spawn("worker", lambda: ran.append(scheduler.now))
    scheduler.at(1.0, paused.resume)
    scheduler.at(9.0, lambda: None)
    scheduler.run(5.0)
    assert ran == [3.0, 3.0]
