"""An agent tells what its containers count."""

from __future__ import annotations

import itertools
import os
import threading
import time

import msgspec
import pytest

from poise import threads
from poise.kernel_counters import proportional_memory, resident_memory
from poise.runtime import _calls
from poise.runtime._calls import ComponentCounters, PageSampler
from poise.runtime.execution.counters import new_memory
from poise.runtime.supervision.sampler import Sampler
from poise.wire.records.status_records import AgentSample


def decoded(body: bytes) -> AgentSample:
    return msgspec.msgpack.decode(body, type=AgentSample)


def ignore(_: object) -> None:
    pass


@pytest.mark.parametrize("every", [0.0, 1.0])
def test_tells_every_container_with_something_in_it(every: float) -> None:
    memories = [new_memory(), new_memory()]
    counters = [ComponentCounters(), ComponentCounters()]
    readers = [PageSampler(memory, os.getpid()) for memory in memories]
    counters[0].enter(_calls.StatsPage(memories[0]), "eye", 2)
    here = [("see", 7, readers[0]), ("empty", 8, readers[1])]
    sampler = Sampler("a", every, lambda: here, ignore, ignore)
    sample = decoded(sampler.sample(1.0))
    assert sample.computer == "a"
    (container,) = sample.containers
    assert (container.name, container.pid) == ("see", 7)
    (eye,) = container.components
    assert (eye.name, eye.epoch, eye.asked) == ("eye", 2, 0)
    for memory in memories:
        os.close(memory)


def test_tells_again_and_again() -> None:
    memory, counters = new_memory(), ComponentCounters()
    counters.enter(_calls.StatsPage(memory), "eye", 0)
    reader = PageSampler(memory, os.getpid())
    told: list[AgentSample] = []
    enough = threading.Event()

    def publish(body: bytes) -> None:
        told.append(decoded(body))
        if len(told) >= 3:
            enough.set()

    pid = os.getpid()
    sampler = Sampler("a", 0.001, lambda: [("see", pid, reader)], publish, ignore)
    sampler.start()
    assert enough.wait(20)
    sampler.stop()
    os.close(memory)
    moments = [sample.containers[0].at for sample in told]
    assert moments == sorted(set(moments))
    assert told[-1].containers[0].memory > 1e6


def test_what_could_not_be_told_once_ends_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told: list[bytes] = []
    failures: list[str] = []
    monkeypatch.setattr(threading, "excepthook", threading.excepthook)  # as it was
    threads.hear_failures(lambda name, error: failures.append(f"{name}: {error}"))
    enough = threading.Event()

    def publish(body: bytes) -> None:
        told.append(body)
        if len(told) == 1:
            raise RuntimeError("nobody listens")
        enough.set()

    sampler = Sampler("a", 0.001, list, publish, ignore)
    sampler.start()
    assert enough.wait(20)
    sampler.stop()
    assert failures == ["sampler: nobody listens"]


def test_reads_the_memory_of_processes() -> None:
    assert proportional_memory(os.getpid()) > 1e6
    assert proportional_memory(1 << 30) == 0
    assert resident_memory(os.getpid()) >= proportional_memory(os.getpid())
    assert resident_memory(1 << 30) == 0


def test_memory_is_read_after_what_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes a while, and what is counted is of the moment that the sample tells."""
    read_at = list[float]()

    def read(_: int) -> int:
        read_at.append(time.monotonic())
        return 1

    monkeypatch.setattr("poise.runtime.supervision.sampler.private_memory", read)
    memory, counters = new_memory(), ComponentCounters()
    counters.enter(_calls.StatsPage(memory), "eye", 0)
    here = [("see", os.getpid(), PageSampler(memory, os.getpid()))]
    sampler = Sampler("a", 0, lambda: here, ignore, ignore)
    sample = decoded(sampler.sample(time.monotonic()))
    assert sample.at <= sample.containers[0].at <= read_at[0]
    os.close(memory)


def test_memory_is_weighed_again_when_there_is_more_or_less_of_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It and the agent are due at every fifth look in turn, each tenth time anyway."""
    held, weighed = [1000], list[int]()

    def weigh(pid: int) -> int:
        if pid == 1:  # the container's, and not the agent's own
            weighed.append(held[0])
        return held[0] // 2

    monkeypatch.setattr(
        "poise.runtime.supervision.sampler.resident_memory", lambda _: held[0]
    )
    monkeypatch.setattr("poise.runtime.supervision.sampler.proportional_memory", weigh)
    memory, counters = new_memory(), ComponentCounters()
    counters.enter(_calls.StatsPage(memory), "eye", 0)
    here = [("see", 1, PageSampler(memory, os.getpid()))]
    sampler = Sampler("a", 0, lambda: here, ignore, ignore)

    seconds = itertools.count()

    def told() -> int:
        return decoded(sampler.sample(next(seconds))).containers[0].memory

    for _ in range(30):
        assert told() == 500
    assert weighed == [1000]
    held[0] = 3000
    assert 1500 in [told() for _ in range(2)]  # what has grown by much is weighed soon
    held[0] = 3100
    assert told() == 1500
    held[0] = 3000
    for _ in range(110):
        told()
    assert weighed == [1000, 3000, 3000]
    os.close(memory)
