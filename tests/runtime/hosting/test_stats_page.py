"""What a container counts is what its agent reads."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import pytest

from poise.runtime import _calls
from poise.runtime._calls import ComponentCounters, PageSampler, ServedCall
from poise.runtime.connectors.route import direct_call, raise_callee_error
from poise.runtime.execution.counters import MOST, Counts, StatsPage, new_memory
from poise.runtime.execution.exclusion import Exclusion
from poise.threads import daemon, take_name
from poise.wire.frame import Frame, FrameKind
from tests.waiting import LONG, wait_until

if TYPE_CHECKING:
    from poise.runtime.hosting.runner import Runner

EPOCH = 3


class Book:
    """A stats_page with both of its ends in this process."""

    def __init__(self, memory: int, proc: str = "/proc") -> None:
        self.stats_page = _calls.StatsPage(memory)
        self.reader = PageSampler(memory, os.getpid(), proc)
        self._held: list[ComponentCounters | Counts] = []

    def counters(self, name: str) -> ComponentCounters:
        counters = ComponentCounters()
        assert counters.enter(self.stats_page, name, EPOCH)
        self._held.append(counters)
        return counters

    def counts(
        self,
        name: str,
        source: ComponentCounters | None,
        target: ComponentCounters | None,
    ) -> Counts:
        counts = Counts()
        assert counts.enter(self.stats_page, name)
        counts.attribute(source, target)
        self._held.append(counts)
        return counts

    def component(self, name: str) -> tuple[str, int, float, float, int, int]:
        read = self.reader.read()
        assert read is not None
        (found,) = [each for each in read[2] if each[0] == name]
        return found

    def cpu(self, name: str) -> float:
        return self.component(name)[2]

    def jobs(self, name: str) -> tuple[int, int]:
        """Return how many were asked for, and done."""
        return self.component(name)[4:]


@pytest.fixture
def memory() -> Iterator[int]:
    fd = new_memory()
    yield fd
    os.close(fd)


@pytest.fixture
def book(memory: int) -> Book:
    return Book(memory)


def burn(seconds: float) -> None:
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        pass


def test_tells_nothing_while_nothing_is_entered(book: Book) -> None:
    assert book.reader.read() is None


def test_tells_what_a_connector_counts(book: Book) -> None:
    book.counters("eye")
    counts = Counts()
    counts.calls, counts.bytes_out, counts.bytes_in = 2, 10, 20
    counts.enter(book.stats_page, "eye.x-mind.x")
    counts.calls += 1
    counts.messages, counts.errors, counts.drops = 4, 5, 6
    read = book.reader.read()
    assert read is not None
    assert read[3] == [("eye.x-mind.x", 3, 4, 10, 20, 5, 6, 0, 0.0, 0.0)]


def test_tells_how_long_what_came_was_under_way(book: Book) -> None:
    """A call and a message of whom it is known, and a message of whom it is not."""
    book.counters("eye")
    counts = book.counts("eye.x-mind.x", None, None)
    counts.add_call(1.0, 10, 20, 0.5, 0.125)
    counts.add_message(0, 30, 0.25, 0.25)
    counts.add_message(0, 30)
    read = book.reader.read()
    assert read is not None
    assert read[3] == [("eye.x-mind.x", 1, 2, 10, 80, 0, 0, 2, 0.75, 0.375)]
    assert (counts.latency.summary().count, counts.latency_error) == (2, 0.1875)
    assert counts.size.summary().maximum == 30


def test_what_comes_before_it_was_sent_was_not_under_way(book: Book) -> None:
    """The clocks are known within an error: by that much it may seem so."""
    book.counters("eye")
    counts = book.counts("eye.x-mind.x", None, None)
    counts.add_message(0, 1, -0.5, 0.75)
    assert counts.latency.summary().maximum == 0
    read = book.reader.read()
    assert read is not None
    assert read[3][0][-3:] == (1, 0.0, 0.75)


def test_counts_go_on_outside(book: Book) -> None:
    counters = book.counters("eye")
    counts = book.counts("eye.x-mind.x", counters, None)
    counts.calls = 7
    counts.leave()
    counts.leave()
    counts.calls += 1
    assert counts.calls == 8
    read = book.reader.read()
    assert read is not None
    assert read[3] == []
    counters.leave()
    assert book.reader.read() is None


def test_a_line_is_used_again_under_another_name(book: Book) -> None:
    book.counters("eye")
    for name in ("one", "two"):
        counters = book.counters(name)
        counters.note_done()
        assert book.jobs(name) == (0, 0)  # nothing was asked for
        counters.leave()
    read = book.reader.read()
    assert read is not None
    assert [each[:2] for each in read[2]] == [("eye", EPOCH)]


def test_tells_the_cpu_time_of_a_thread_also_after_its_end(book: Book) -> None:
    counters = book.counters("eye")
    burned, may_end = threading.Event(), threading.Event()

    def work() -> None:
        counters.begin()
        burn(0.05)
        burned.set()
        may_end.wait(20)
        counters.end()

    thread = threading.Thread(target=work)
    thread.start()
    assert burned.wait(20)
    # the kernel's number may be a tick old
    wait_until(lambda: book.cpu("eye") >= 0.05)
    may_end.set()
    thread.join(20)
    assert 0.05 <= book.cpu("eye") < 0.2
    assert counters.cpu() == pytest.approx(book.cpu("eye"))


def test_a_call_counts_for_its_callee(book: Book) -> None:
    """Of 0.3 s on the caller's thread 0.2 s were the callee's, 0.05 s the third's."""
    caller, callee, third = (book.counters(n) for n in ("caller", "callee", "third"))
    there = book.counts("caller.x-callee.x", caller, callee)
    on = book.counts("callee.x-third.x", callee, third)
    before = book.cpu("caller")
    there.add_cpu(0.2)
    on.add_cpu(0.05)
    assert book.cpu("caller") - before == pytest.approx(-0.2)
    assert book.cpu("callee") == pytest.approx(0.15)
    assert book.cpu("third") == pytest.approx(0.05)


def test_a_call_from_another_container_takes_from_nobody(book: Book) -> None:
    callee = book.counters("callee")
    book.counts("caller.x-callee.x", None, callee).add_cpu(0.2)
    assert book.cpu("callee") == pytest.approx(0.2)


def test_calls_to_one_that_left_count_for_nobody(book: Book) -> None:
    caller, callee = book.counters("caller"), book.counters("callee")
    book.counts("caller.x-callee.x", caller, callee).add_cpu(0.2)
    callee.leave()
    book.counters("other")  # takes the callee's line
    assert book.cpu("caller") == book.cpu("other") == 0.0


def test_who_only_answers_has_its_calls_for_jobs(book: Book) -> None:
    callee = book.counters("callee")
    counts = book.counts("caller.x-callee.x", None, callee)
    counts.calls = 9
    assert book.jobs("callee") == (9, 9)
    callee.note_asked()
    assert book.jobs("callee") == (1, 0)


def test_releases_are_asked_for_though_nobody_wakes(book: Book) -> None:
    """From -10.5 s on every second: 10 releases; those of a shut timer stay."""
    counters = book.counters("eye")
    now = time.monotonic()
    counters.plan([(now - 10.5, 1e3), (now - 105e3, 1e4)])
    counters.note_asked()
    counters.note_done()
    assert book.jobs("eye") == (11, 1)
    counters.plan([])
    assert book.jobs("eye") == (11, 1)
    counters.plan([(now - 21e4, 1e5)])
    assert book.jobs("eye") == (13, 1)


def test_timers_planned_before_are_entered_too(book: Book) -> None:
    counters = ComponentCounters()
    counters.plan([(time.monotonic() - 35e3, 1e4)])
    counters.enter(book.stats_page, "eye", EPOCH)
    assert book.jobs("eye") == (3, 0)


def test_a_stats_page_that_is_full_takes_no_more(tmp_path: Path) -> None:
    small = tmp_path / "stats_page"
    small.write_bytes(bytes(64 + 2 * _calls.RECORD_SIZE))
    with small.open("r+b") as file:
        stats_page = _calls.StatsPage(file.fileno())
    all_counters = [ComponentCounters() for _ in range(3)]
    assert [a.enter(stats_page, "x", 0) for a in all_counters] == [True, True, False]
    all_counters[0].leave()
    assert all_counters[2].enter(stats_page, "x", 0)


def test_memory_that_is_no_stats_page_is_refused(tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    empty.touch()
    with empty.open("rb") as file, pytest.raises(RuntimeError, match="too small"):
        PageSampler(file.fileno(), os.getpid())


def test_a_name_may_be_as_long_as_two_components_and_their_ports(book: Book) -> None:
    name = "-".join(["é" * 31 + "." + "x" * 63] * 2)
    book.counters(name)
    assert book.component(name)[0] == name
    book.counters("x" * 300)
    assert book.component("x" * 255)


@pytest.mark.slow
def test_counts_a_process_as_its_command(book: Book) -> None:
    counters = book.counters("driver")
    with subprocess.Popen([sys.executable, "-c", "while True: pass"]) as process:
        counters.watch(process.pid)
        wait_until(lambda: book.cpu("driver") >= 0.01)
        assert book.reader.descendants() == [process.pid]
        read = book.reader.read()
        assert read is not None
        assert read[1] > book.cpu("driver") - 1  # it is in the container's time
        process.kill()
    counters.end()
    assert book.cpu("driver") == 0.0
    assert book.reader.descendants() == []


BURN = """
import time
while time.process_time() < 0.3: pass
"""
REAPS = f"""
import subprocess, sys
for _ in range(2):
    subprocess.run([sys.executable, "-S", "-c", {BURN!r}])
subprocess.run([sys.executable, "-S", "-c", {BURN + "time.sleep(60)"!r}])
"""
REAPS_NONE = f"import signal; signal.signal(signal.SIGCHLD, signal.SIG_IGN)\n{REAPS}"


def as_component(book: Book, name: str, work: Callable[[], None]) -> threading.Thread:
    """Run something on the thread of a component."""
    counters, told = book.counters(name), threading.Event()

    def main() -> None:
        take_name(name)
        counters.begin()
        told.set()
        work()
        counters.end()

    thread = threading.Thread(target=main)
    thread.start()
    assert told.wait(LONG)
    return thread


@pytest.mark.slow
def test_threads_that_a_component_started_belong_to_it(book: Book) -> None:
    """Two components of one name for the kernel are told apart by nothing."""
    ended = threading.Event()

    def spin() -> None:
        while not ended.is_set():
            burn(0.01)

    def own() -> None:
        threading.Thread(target=spin).start()
        daemon(spin, "drain").start()
        ended.wait()

    def both() -> None:
        threading.Thread(target=spin).start()
        ended.wait()

    def wait() -> None:
        ended.wait()

    names = ("eye", "a_very_long_name", "a_very_lo_ng_name", "ear")
    threads = [
        as_component(book, name, work)
        for name, work in zip(names, (own, both, both, wait), strict=True)
    ]
    wait_until(lambda: book.cpu("eye") >= 0.1)
    assert max(book.cpu(name) for name in names[1:]) < 0.05
    ended.set()
    for thread in threads:
        thread.join()
    assert book.cpu("eye") >= 0.1


@pytest.mark.slow
def test_processes_that_a_component_started_belong_to_it(book: Book) -> None:
    ended = threading.Event()

    def own() -> None:
        script = BURN + "time.sleep(1.5)"
        subprocess.run([sys.executable, "-S", "-c", script], check=True)
        ended.wait()

    def wait() -> None:
        ended.wait()

    threads = [
        as_component(book, "eye", own),
        as_component(book, "ear", wait),
    ]
    wait_until(lambda: book.cpu("eye") >= 0.3)
    wait_until(lambda: book.cpu("eye") and not book.reader.descendants())
    assert book.cpu("eye") >= 0.3
    assert book.cpu("ear") < 0.05
    ended.set()
    for thread in threads:
        thread.join()


def child_of(book: Book, process: int) -> int | None:
    """Return the one that runs as last seen."""
    return next((each for each in book.reader.descendants() if each != process), None)


@pytest.mark.slow
def test_what_a_command_started_belongs_to_it(book: Book) -> None:
    """Two that have ended used 0.3 s each, and one goes on."""
    counters = book.counters("driver")
    with subprocess.Popen([sys.executable, "-S", "-c", REAPS]) as process:
        counters.watch(process.pid)
        # ticks are cut off; the third may start after Python's own time is enough
        wait_until(lambda: book.cpu("driver") >= 0.88 and child_of(book, process.pid))
        assert counters.cpu() == pytest.approx(book.cpu("driver"), abs=0.1)
        read = book.reader.read()
        assert read is not None
        assert read[1] >= time.process_time() + 0.88
        child = child_of(book, process.pid)
        assert child is not None
        os.kill(child, signal.SIGKILL)


@pytest.mark.slow
def test_the_time_of_a_child_stays_when_nobody_takes_note_of_its_end(
    book: Book,
) -> None:
    """The kernel adds it to no parent that ignores the ends of its children."""
    counters = book.counters("driver")
    words = [sys.executable, "-S", "-c", REAPS_NONE + "import time; time.sleep(60)"]
    with subprocess.Popen(words, start_new_session=True) as process:
        counters.watch(process.pid)
        wait_until(lambda: book.cpu("driver") >= 0.3 and child_of(book, process.pid))
        before, child = book.cpu("driver"), child_of(book, process.pid)
        assert child is not None
        os.kill(child, signal.SIGKILL)
        wait_until(lambda: book.cpu("driver") and child_of(book, process.pid) != child)
        assert book.cpu("driver") >= before
        os.killpg(process.pid, signal.SIGKILL)  # with the next child


def test_without_the_schedulers_counters_there_are_ticks(
    memory: int, tmp_path: Path
) -> None:
    """70 + 30 ticks of 10 ms are a second; nobody tells of waits then."""
    book = Book(memory, str(tmp_path))
    counters = book.counters("eye")
    counters.begin()
    thread = tmp_path / str(threading.get_native_id())
    thread.mkdir()
    (thread / "stat").write_text("5 (a) (b) R 1 2 3 4 -5 6 7 8 9 10 70 30 0 0 20 0")
    assert book.component("eye")[2:4] == (1.0, 0.0)


def test_what_is_dropped_is_told_of_no_more(book: Book) -> None:
    counters = ComponentCounters()
    counters.enter(book.stats_page, "eye", EPOCH)
    del counters
    assert book.reader.read() is None


@pytest.mark.slow
def test_a_process_that_has_ended_is_not_told_of(memory: int) -> None:
    book = Book(memory)
    book.counters("eye")
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        process.wait(20)
        pid = process.pid
    assert PageSampler(memory, pid).read() is None


class Calls:
    """A chain of direct calls on a thread of the first; the last one spins."""

    def __init__(self, book: Book, names: list[str]) -> None:
        self.counters = [book.counters(name) for name in names]
        self.counts = [
            book.counts(f"{a}.x-{b}.x", self.counters[at], self.counters[at + 1])
            for at, (a, b) in enumerate(pairwise(names))
        ]
        self.may_end, self.may_leave = threading.Event(), threading.Event()
        work: Callable[[], object] = self._spin
        for name, counts in zip(names[:0:-1], reversed(self.counts), strict=True):
            exclusion = Exclusion(name)
            exclusion.resume()
            work = direct_call(work, exclusion, 20.0, counts)
        self._work = work
        self._name = names[0]
        self.thread = threading.Thread(target=self._main, daemon=True)
        self.thread.start()

    def _spin(self) -> None:
        while not self.may_end.is_set():
            burn(0.001)

    def _main(self) -> None:
        take_name(self._name)  # or others of its name count for it, pytest's say
        self.counters[0].begin()
        self._work()
        self.may_leave.wait(20)
        self.counters[0].end()


def test_the_cpu_time_of_a_call_counts_for_its_callee_while_it_runs(book: Book) -> None:
    """The caller's thread runs it all; the second and the caller only wait."""
    calls = Calls(book, ["caller", "second", "third"])
    book.reader.read()  # from here on it is known
    wait_until(lambda: book.cpu("third") >= 0.1)
    assert abs(book.cpu("second")) < 0.02
    assert book.cpu("caller") < 0.1
    calls.may_end.set()
    calls.may_leave.set()
    calls.thread.join(20)


def test_a_call_that_ends_is_counted_once(book: Book) -> None:
    calls = Calls(book, ["caller", "callee"])
    wait_until(lambda: book.cpu("callee") >= 0.1)
    calls.may_end.set()
    wait_until(lambda: calls.counts[0].calls == 1)
    assert book.cpu("callee") == pytest.approx(calls.counts[0].cpu)
    calls.may_leave.set()
    calls.thread.join(20)
    used = calls.counters[0].cpu()
    assert book.cpu("caller") + book.cpu("callee") == pytest.approx(used, abs=1e-6)


def test_a_call_from_another_container_counts_while_it_runs(book: Book) -> None:
    callee = book.counters("callee")
    counts = book.counts("caller.x-callee.x", None, callee)
    exclusion = Exclusion("callee")
    exclusion.resume()
    may_end = threading.Event()

    def spin(*_: object) -> None:
        while not may_end.is_set():
            burn(0.001)

    served = ServedCall(
        decode=lambda body, buffers: (body, bytes(buffers)),
        method=spin,
        encode=lambda _: [b""],
        exclusion=exclusion,
        limit=20.0,
        counts=counts,
        translate=raise_callee_error,
        is_over=lambda: False,
    )
    frame = Frame(FrameKind.CALL, 0, 0, 7, b"body", memoryview(b"buffers"), 0, 0.0, 0.0)
    thread = threading.Thread(target=served, args=(frame,), daemon=True)
    thread.start()
    wait_until(lambda: book.cpu("callee") >= 0.1)
    may_end.set()
    thread.join(20)
    assert book.cpu("callee") == pytest.approx(counts.cpu)


def test_a_call_that_waits_uses_nothing(book: Book) -> None:
    caller, callee = book.counters("caller"), book.counters("callee")
    counts = book.counts("caller.x-callee.x", caller, callee)
    exclusion, may_end, runs = Exclusion("callee"), threading.Event(), threading.Event()
    exclusion.resume()

    def wait() -> None:
        runs.set()
        may_end.wait(20)

    call = direct_call(wait, exclusion, 20.0, counts)
    thread = threading.Thread(target=call, daemon=True)
    thread.start()
    assert runs.wait(20)
    book.reader.read()
    burn(0.05)  # on another thread
    assert book.cpu("callee") < 0.01
    may_end.set()
    thread.join(20)


def test_what_has_no_room_on_the_page_is_said_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    page = StatsPage(new_memory())
    taken = [ComponentCounters() for _ in range(MOST)]
    for number, counters in enumerate(taken):
        counters.enter(page._native, f"other-{number}", EPOCH)
    mine = cast("Runner", SimpleNamespace(counters=ComponentCounters(), ports={}))
    for _ in range(2):
        page.show({("mine", EPOCH): mine}, ())
    (said,) = caplog.messages
    assert said == f"component 'mine' is not counted: all {MOST} records are in use"
    for counters in taken:
        counters.leave()
    page.show({("mine", EPOCH): mine}, ())
    assert page.cpu()[1].keys() == {("mine", EPOCH)}
