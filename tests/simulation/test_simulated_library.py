"""What code under test gets of the standard library."""

from __future__ import annotations

import queue
import random
import socket
import subprocess
import threading
import time
import uuid
from collections.abc import Callable
from functools import partial
from types import ModuleType
from typing import Any

import pytest

from poise.clock import boot_id, time_of_day
from poise.manage.tasks import saved_tasks, task_manager
from poise.simulation import choices
from poise.simulation.choices import Choices
from poise.simulation.network import Addresses, Network
from poise.simulation.robot.simulated_process import SimulatedComputer
from poise.simulation.scheduler import Scheduler, SimulationError
from poise.simulation.simulated_library import SimulatedLibrary
from poise.simulation.zenoh_sessions import ZenohNetwork

Run = Callable[[Callable[[], Any]], Any]


@pytest.fixture
def run(scheduler: Scheduler) -> Run:
    """Return what runs a function in a simulated process, and returns its result."""
    network, addresses = Network(scheduler), Addresses()
    addresses.add("a")
    process = SimulatedComputer(scheduler, "a", boot=50.0).start("program")

    def in_process(work: Callable[[], Any]) -> Any:
        found: list[Any] = []
        process.spawn("test", lambda: found.append(work()))
        with SimulatedLibrary(scheduler, ZenohNetwork(network, addresses)):
            scheduler.run(scheduler.now + 1000.0)
        return found[0]

    return in_process


def test_sleeps_and_clocks_are_virtual(run: Run) -> None:
    def work() -> tuple[float, float, float]:
        began, wall = time.monotonic(), time.time()
        time.sleep(100.0)
        return began, time.monotonic() - began, time.time() - wall

    began, slept, wall = run(work)
    assert began == 50.0
    assert slept == pytest.approx(100.0, abs=1e-3)
    assert wall == pytest.approx(100.0, abs=1e-3)


def test_the_time_of_day_is_the_same_in_each_time_zone(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else the same seed would not tell the same on another machine."""
    monkeypatch.setenv("TZ", "Asia/Tokyo")
    time.tzset()
    try:
        assert run(lambda: time_of_day(time.time())) == "00:00:00"
    finally:
        monkeypatch.undo()
        time.tzset()


def test_each_computer_knows_its_own_start(run: Run) -> None:
    """A manager that takes over elsewhere sees that its clock is another one."""
    for module in (saved_tasks, task_manager):
        assert run(partial(_own_boot_id, module)) == f"{'a':-<36}"
        assert _own_boot_id(module) == boot_id()


def _own_boot_id(module: ModuleType) -> Any:
    return vars(module)["boot_id"]()


def test_code_outside_of_the_simulation_reads_the_real_clock(
    scheduler: Scheduler,
) -> None:
    computer, read = SimulatedComputer(scheduler, "a", boot=50.0), list[float]()
    process = computer.start("program")
    process.spawn("test", lambda: read.append(time.monotonic()))
    sessions = ZenohNetwork(Network(scheduler), Addresses())
    before = time.monotonic()
    with SimulatedLibrary(scheduler, sessions):
        scheduler.run(1.0)
        assert time.monotonic() >= before
    assert read == [50.0]


def test_a_default_without_a_hash_is_left_as_it_is(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its type has one, and what it holds has none."""

    class Waiting:
        def wait(self, clock: Any = time.monotonic, seen: Any = ([],)) -> Any:
            return clock(), seen

    monkeypatch.setattr(choices, "Waiting", Waiting, raising=False)
    assert run(lambda: Waiting().wait()) == (50.0, ([],))


def test_a_condition_that_nobody_notifies_times_out_in_virtual_time(run: Run) -> None:
    def work() -> tuple[bool, float]:
        condition, began = threading.Condition(), time.monotonic()
        with condition:
            told = condition.wait_for(lambda: False, 5.0)
        return told, time.monotonic() - began

    told, took = run(work)
    assert not told
    assert took == pytest.approx(5.0, abs=1e-3)


def test_a_queue_hands_over_between_threads(run: Run) -> None:
    def work() -> list[int]:
        numbers: queue.SimpleQueue[int] = queue.SimpleQueue()

        def produce() -> None:
            for number in range(3):
                time.sleep(1.0)
                numbers.put(number)

        threading.Thread(target=produce).start()
        return [numbers.get(timeout=10.0) for _ in range(3)]

    assert run(work) == [0, 1, 2]


def test_a_lock_that_timed_out_for_one_thread_goes_to_the_next(run: Run) -> None:
    def work() -> list[str]:
        lock, got = threading.Lock(), list[str]()
        lock.acquire()

        def take(name: str, limit: float) -> None:
            if lock.acquire(timeout=limit):
                got.append(name)
                lock.release()

        threads = [
            threading.Thread(target=take, args=args)
            for args in (("short", 1.0), ("long", 9.0))
        ]
        for thread in threads:
            thread.start()
        time.sleep(2.0)
        lock.release()
        for thread in threads:
            thread.join()
        return got

    assert run(work) == ["long"]


def test_chance_is_drawn_from_the_seed() -> None:
    def drawn() -> tuple[float, str]:
        found: list[tuple[float, str]] = []
        scheduler = Scheduler(Choices(5))
        sessions = ZenohNetwork(Network(scheduler), Addresses())
        scheduler.at(9.0, lambda: None)
        process = SimulatedComputer(scheduler, "a").start("program")
        process.spawn("test", lambda: found.append((random.random(), uuid.uuid4().hex)))
        with SimulatedLibrary(scheduler, sessions):
            scheduler.run(1.0)
        return found[0]

    assert drawn() == drawn()


@pytest.mark.parametrize(
    "work",
    [
        lambda: subprocess.Popen(["true"]),
        lambda: socket.socket(socket.AF_INET, socket.SOCK_STREAM),
        lambda: socket.socketpair(),  # noqa: PLW0108 - looked up when it is called
    ],
)
def test_what_would_leave_the_simulation_is_an_error(
    run: Run, work: Callable[[], object]
) -> None:
    with pytest.raises(SimulationError):
        run(work)
