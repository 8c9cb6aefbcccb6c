"""What becomes of the exceptions that end threads."""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from poise import threads


@pytest.fixture
def failures() -> Iterator[list[tuple[str, str]]]:
    found: list[tuple[str, str]] = []
    hook = threading.excepthook
    threads.hear_failures(lambda name, error: found.append((name, repr(error))))
    yield found
    threading.excepthook = hook


def fail() -> None:
    raise KeyError("a bug")


def run(thread: threading.Thread) -> None:
    thread.start()
    thread.join(10.0)
    assert not thread.is_alive()


def test_what_keeps_a_process_from_starting_has_a_way_out() -> None:
    for number, way in (
        (errno.EFBIG, "File too large: raise the limit of a file's size (`ulimit -f`)"),
        (errno.EMFILE, "Too many open files: raise the limit of open files"),
    ):
        said = threads.without_process(OSError(number, os.strerror(number)))
        assert said.startswith(f"cannot be started: {way}")
    assert threads.without_process(OSError(5, "I/O")) == "cannot be started: I/O"


def test_the_owner_of_a_thread_hears_of_its_failure(
    failures: list[tuple[str, str]], caplog: pytest.LogCaptureFixture
) -> None:
    run(threads.daemon(fail, "flush"))
    assert failures == [("flush", "KeyError('a bug')")]
    assert "in fail" in caplog.text  # the traceback


def test_it_hears_of_threads_that_others_started(
    failures: list[tuple[str, str]],
) -> None:
    run(threading.Thread(target=fail, name="a library's"))
    assert failures == [("a library's", "KeyError('a bug')")]


def test_work_that_must_go_on_is_done_again(failures: list[tuple[str, str]]) -> None:
    done: list[str] = []

    def work(what: str) -> None:
        done.append(what)
        if len(done) < 2:
            fail()

    run(threads.daemon(work, "sampler", "sampled", again=True))
    assert done == ["sampled"] * 2
    assert failures == [("sampler", "KeyError('a bug')")]


def test_an_owner_that_fails_at_it_hides_nothing(
    caplog: pytest.LogCaptureFixture,
) -> None:
    hook = threading.excepthook
    threads.hear_failures(lambda _name, _error: fail())
    run(threads.daemon(fail, "flush"))
    threading.excepthook = hook
    assert "thread 'flush' failed" in caplog.text
    assert "could not be reported" in caplog.text


def test_a_program_in_anothers_process_hears_of_them_for_a_time(
    failures: list[tuple[str, str]],
) -> None:
    heard: list[str] = []
    with threads.failures_heard(lambda name, _: heard.append(name)):
        run(threads.daemon(fail, "metrics"))
    run(threads.daemon(fail, "later"))
    assert heard == ["metrics"]
    assert [name for name, _ in failures] == ["metrics", "later"]


def test_a_failure_is_shown_with_its_thread() -> None:
    failures = threads.Failures("container 'see'")
    assert not failures.trouble()
    failures.note("flush", KeyError("a bug"))
    trouble = failures.trouble()
    assert "in container 'see' the thread 'flush' failed: KeyError('a bug')" in trouble
    # not that of a component: a thread which it starts writes as its container
    assert "(`poise log` has the traceback)" in trouble


def test_long_names_are_told_apart_by_the_kernel() -> None:
    found: list[str] = []

    def look(name: str) -> None:
        threads.take_name(name)
        found.append(Path("/proc/thread-self/comm").read_text().strip())

    for name in ("eye", "object_detector_1", "object_detector_2"):
        run(threads.daemon(look, "look", name))
    assert found == ["eye", "object_~ector_1", "object_~ector_2"]
