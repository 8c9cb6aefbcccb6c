import os
import threading
import time
from pathlib import Path

import msgspec

from poise.runtime.collector import Collector
from poise.runtime.sampler import (
    Page,
    Sampler,
    ThreadWait,
    proportional_memory,
    sample_path,
)
from poise.wire.samples import AgentSample, ComponentSample, ContainerSample


def a_sample(memory: int) -> ContainerSample:
    eye = ComponentSample("eye", 0, time.thread_time(), 0.0, 3, 2)
    return ContainerSample("see", 7, time.monotonic(), 0.5, memory, (eye,), ())


def started(path: Path) -> Sampler:
    sampler = Sampler(path, 0.001, a_sample, lambda: 1234)
    sampler.start()
    return sampler


def test_an_agent_tells_what_containers_leave(tmp_path: Path) -> None:
    told: list[AgentSample] = []
    heard = threading.Event()

    def publish(body: bytes) -> None:
        sample = msgspec.msgpack.decode(body, type=AgentSample)
        if sample.containers:
            told.append(sample)
            heard.set()

    collector = Collector("a", tmp_path, 0.001, lambda: [("see", 7)], publish)
    collector.start()  # before the container, as it may be
    sampler = started(sample_path(tmp_path, "see", 7))
    try:
        assert heard.wait(10)
    finally:
        sampler.stop()
        collector.stop()
    (container,) = told[0].containers
    assert (container.name, container.memory) == ("see", 1234)
    assert container.components[0].asked == 3


def test_the_same_sample_is_told_once(tmp_path: Path) -> None:
    path = tmp_path / "see.7.samples"
    sampler, page = started(path), Page(path)
    try:
        end = time.monotonic() + 10
        bodies: list[bytes] = []
        while len(bodies) < 20 and time.monotonic() < end:
            body = page.read()
            bodies += [body] if body else []
    finally:
        sampler.stop()
        page.close()
    assert len(bodies) == 20
    assert len(set(bodies)) == 20
    for body in bodies:  # none was read while it was written
        assert msgspec.msgpack.decode(body, type=ContainerSample).pid == 7


def test_nothing_is_told_of_a_file_that_is_not_there(tmp_path: Path) -> None:
    assert Page(tmp_path / "none").read() is None


def test_leaves_no_file_behind(tmp_path: Path) -> None:
    path = tmp_path / "see.7.samples"
    started(path).stop()
    assert not path.exists()


def test_reads_the_kernels_counters() -> None:
    assert proportional_memory() > 1e6
    assert proportional_memory(1 << 30) == 0
    wait = ThreadWait()
    assert wait.read(os.getpid()) >= 0
    wait.close()
    assert ThreadWait().read(1 << 30) == 0.0
