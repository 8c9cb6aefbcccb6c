"""Waiting for several things, and being woken."""

from __future__ import annotations

import contextlib
import os
import resource
import socket
from collections.abc import Iterator

import pytest

from poise.waker import Waker, is_writable, wait_readable

LIMIT = 20.0


@pytest.fixture
def waker() -> Iterator[Waker]:
    waker = Waker()
    yield waker
    waker.close()


def test_a_wake_is_seen_until_it_is_cleared(waker: Waker) -> None:
    assert wait_readable([waker.fileno()], 0.0) == set()
    waker.wake()
    assert wait_readable([waker.fileno()], LIMIT) == {waker.fileno()}
    waker.clear()
    waker.clear()
    assert wait_readable([waker.fileno()], 0.0) == set()


def test_waking_never_blocks(waker: Waker) -> None:
    for _ in range(100_000):  # more than a pipe holds
        waker.wake()
    waker.clear()


def test_the_end_of_a_file_is_news() -> None:
    end, other = os.pipe()
    os.close(other)
    assert wait_readable([end], LIMIT) == {end}
    os.close(end)


def test_high_descriptors_are_watched_too(waker: Waker) -> None:
    high = 2000
    if resource.getrlimit(resource.RLIMIT_NOFILE)[0] <= high:
        pytest.skip("this user may not open so many files")
    os.dup2(waker.fileno(), high)
    waker.wake()
    assert wait_readable([high], LIMIT) == {high}
    os.close(high)


@pytest.mark.slow
def test_a_full_socket_is_not_writable() -> None:
    one, other = socket.socketpair()
    with one, other:
        assert is_writable(one.fileno())
        one.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                one.send(bytes(10_000))
        assert not is_writable(one.fileno())
