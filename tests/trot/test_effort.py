from __future__ import annotations

import time

import pytest

from trot.effort import BLOCK, Block, Effort


def test_works_until_the_declared_cpu_time_is_used() -> None:
    """CPU time of the thread: what else the machine does is not in it."""
    effort = Effort(cpu=0.02)
    since = effort.start()
    pieces = effort.spend(lambda block: block.sum(), since)
    assert pieces > 10
    assert time.thread_time() - since == pytest.approx(0.02, rel=0.1)


def test_counts_what_was_done_before() -> None:
    effort = Effort(cpu=0.0)
    assert effort.spend(lambda block: block.sum(), effort.start()) == 0


def test_walks_over_its_whole_working_set() -> None:
    """256 KiB are four blocks of 64 KiB; the fifth is the first again."""
    effort = Effort(cpu=0.0, working_set=256 * 1024)
    blocks = [effort.next_block() for _ in range(5)]
    assert [block.shape for block in blocks] == [(BLOCK,)] * 5
    starts = [block.ctypes.data for block in blocks]
    assert len(set(starts)) == 4
    assert starts[4] == starts[0]


def test_reads_quantities_as_people_write_them() -> None:
    effort = Effort.declared({"cpu": "5 ms", "working_set": "1 MiB"})
    assert effort.cpu == 0.005
    first = effort.next_block()
    seen: list[Block] = [effort.next_block() for _ in range(16)]
    assert seen[-1].ctypes.data == first.ctypes.data
