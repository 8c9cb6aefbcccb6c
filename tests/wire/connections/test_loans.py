"""A loan crosses without a copy, and nobody's array changes under its hands."""

from __future__ import annotations

import gc
import os
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from poise import loan
from poise.errors import Unavailable
from poise.wire import frame
from poise.wire.codec import WireError, codec
from poise.wire.connections.blocks import MOST_BLOCKS, MOST_LENT, THRESHOLD, Blocks
from poise.wire.connections.connection import Connection
from poise.wire.frame import FrameKind

pytestmark = pytest.mark.slow

ANY = codec(Any)
LONG = 20.0
SIZE = 1 << 20


class Receiver:
    """The other end of a connection, where a thread keeps all that comes."""

    def __init__(self) -> None:
        ours, theirs = socket.socketpair()
        self.sender, self.connection = Connection(ours), Connection(theirs)
        self.got: list[Any] = []
        self.errors: list[WireError] = []
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        try:
            while True:
                received = self.connection.receive()
                self.got.append(received.value(ANY))
                del received
                self.connection.send(frame.segments(ANY, None, FrameKind.RESULT))
        except Unavailable:
            pass
        except WireError as error:
            self.errors.append(error)
            self.connection.end()

    def send(self, value: object) -> Any:
        """Send a value, and return what came."""
        deadline = time.monotonic() + LONG
        answer = self.sender.ask(frame.segments(ANY, value, FrameKind.CALL), deadline)
        assert answer is not None
        return self.got[-1]

    def end(self) -> None:
        self.sender.end()
        self._thread.join(LONG)
        self.connection.close()
        self.sender.close()


@pytest.fixture(autouse=True)
def pool(monkeypatch: pytest.MonkeyPatch) -> Blocks:
    """Give the blocks of a process that has none yet."""
    made = Blocks()
    monkeypatch.setattr("poise.wire.connections.blocks.BLOCKS", made)
    monkeypatch.setattr("poise.wire.connections.connection.BLOCKS", made)
    return made


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    found = Receiver()
    yield found
    found.end()


@pytest.fixture
def another() -> Iterator[Receiver]:
    found = Receiver()
    yield found
    found.end()


def filled(number: int, size: int = SIZE) -> Any:
    array = loan(size, np.uint8)
    array[:] = number
    return array


def is_on_a_block(pool: Blocks, array: np.ndarray) -> bool:
    return pool.find(array.data) is not None


def address(array: np.ndarray) -> int:
    return int(array.__array_interface__["data"][0])


def test_a_loan_has_the_wanted_shape_and_type(pool: Blocks) -> None:
    image = loan((480, 640, 3), np.float32)
    assert image.shape == (480, 640, 3)
    assert image.dtype == np.float32
    assert is_on_a_block(pool, image)
    assert loan(100_000).dtype == np.float64


@pytest.mark.parametrize(
    "shape",
    [np.int64(90_000), (np.int32(300), np.int32(300)), np.array([300, 300])],
)
def test_a_shape_may_have_numbers_of_numpy(pool: Blocks, shape: Any) -> None:
    array = loan(shape, np.uint8)
    assert array.size == 90_000
    assert is_on_a_block(pool, array)


def test_nothing_copies_a_loan(receiver: Receiver) -> None:
    """What is written by a way that is left open is seen at the other end."""
    array = filled(1)
    way = array[:]
    got = receiver.send(array)
    assert (got == 1).all()
    way[7] = 2
    assert got[7] == 2


def test_a_loan_that_was_sent_is_read_only(receiver: Receiver) -> None:
    array = filled(1)
    receiver.send(array)
    with pytest.raises(ValueError, match="read-only"):
        array[0] = 2


def test_a_received_loan_is_read_only(receiver: Receiver) -> None:
    with pytest.raises(ValueError, match="read-only"):
        receiver.send(filled(1))[0] = 2


def test_a_loan_that_was_never_sent_is_used_again() -> None:
    first = address(loan(SIZE, np.uint8))
    assert address(loan(SIZE, np.uint8)) == first


def test_a_block_that_the_receiver_let_go_of_is_used_again(receiver: Receiver) -> None:
    array = filled(1)
    receiver.send(array)
    used = address(array)
    del array
    assert address(loan(SIZE, np.uint8)) != used
    receiver.got.clear()
    gc.collect()
    again = loan(SIZE, np.uint8)
    assert address(again) == used
    again[:] = 2
    assert (receiver.send(again) == 2).all()


def test_a_loan_that_its_sender_keeps_stays_as_it_is(receiver: Receiver) -> None:
    kept = [filled(number) for number in range(4)]
    for array in kept:
        receiver.send(array)
    receiver.got.clear()
    gc.collect()
    later = [filled(9) for _ in range(4)]
    assert all((array == number).all() for number, array in enumerate(kept))
    assert all((array == 9).all() for array in later)


def test_what_receivers_keep_stays_as_it_is(pool: Blocks, receiver: Receiver) -> None:
    """More is kept than there are blocks; then arrays are ordinary ones, and copied."""
    most = MOST_BLOCKS + 2
    for number in range(most):
        receiver.send(filled(number))
    assert all((array == n).all() for n, array in enumerate(receiver.got))
    assert not is_on_a_block(pool, loan(SIZE, np.uint8))
    receiver.got.clear()
    gc.collect()
    assert is_on_a_block(pool, loan(SIZE, np.uint8))


def test_two_receivers_have_one_loan(receiver: Receiver, another: Receiver) -> None:
    array = filled(1)
    way, used = array[:], address(array)
    first, second = receiver.send(array), another.send(array)
    way[7] = 2
    assert (first[7], second[7]) == (2, 2)
    del array, way, first
    receiver.got.clear()
    gc.collect()
    assert address(loan(SIZE, np.uint8)) != used
    del second
    another.got.clear()
    gc.collect()
    assert address(loan(SIZE, np.uint8)) == used


def test_a_loan_that_is_sent_again_is_right_both_times(receiver: Receiver) -> None:
    array = filled(1)
    first = receiver.send(array)
    second = receiver.send(array)
    assert (first == 1).all()
    assert (second == 1).all()
    del first
    receiver.got.pop(0)
    gc.collect()
    assert (receiver.send(array) == second).all()


@pytest.mark.parametrize(
    "part",
    [np.s_[:, :], np.s_[:700], np.s_[100:], np.s_[:, 1:], np.s_[::2], np.s_[::-1]],
)
def test_parts_of_loans_cross_too(receiver: Receiver, part: Any) -> None:
    array = loan((1000, 1000), np.uint8)
    array[:] = np.arange(1000) % 251
    assert (receiver.send(array[part]) == array[part]).all()
    assert (receiver.send(array[part].T) == array[part].T).all()


def test_loans_among_other_arrays_are_copied(receiver: Receiver) -> None:
    array = filled(1)
    got = receiver.send([array, np.arange(3), filled(2)])
    assert [a.tolist() for a in got] == [[1] * SIZE, [0, 1, 2], [2] * SIZE]
    array[0] = 3
    assert got[0][0] == 1


@pytest.mark.parametrize("shape", [(), 0, (0, 5), 10, (THRESHOLD - 1,)])
def test_small_arrays_are_ordinary_ones(pool: Blocks, shape: Any) -> None:
    array = loan(shape, np.uint8)
    assert array.shape == np.empty(shape).shape
    assert not is_on_a_block(pool, array)


def test_arrays_of_objects_are_ordinary_ones() -> None:
    assert loan(THRESHOLD, object)[0] is None


def test_refuses_what_no_array_has() -> None:
    with pytest.raises(ValueError, match="negative"):
        loan((-1, -THRESHOLD), np.uint8)


def test_what_is_lent_over_a_connection_that_ended_is_not_used_again(
    receiver: Receiver, another: Receiver
) -> None:
    """The receiver may have lost its connection alone, and have the array still."""
    array = filled(1)
    got = receiver.send(array)
    receiver.end()
    assert (another.send(array) == 1).all()
    del array
    another.got.clear()
    gc.collect()
    later = [filled(2) for _ in range(MOST_LENT)]
    assert all((array == 2).all() for array in later)
    assert (got == 1).all()


def test_what_was_received_outlives_its_sender(receiver: Receiver) -> None:
    got = receiver.send(filled(1))
    receiver.end()
    gc.collect()
    assert (got == 1).all()


def test_links_that_end_give_their_slots_back() -> None:
    slots = set()
    for number in range(3):
        receiver = Receiver()
        assert (receiver.send(filled(number)) == number).all()
        slots.add(receiver.sender._slot)
        receiver.end()
    assert len(slots) == 1


def test_without_a_slot_loans_are_copied(
    pool: Blocks, monkeypatch: pytest.MonkeyPatch, receiver: Receiver
) -> None:
    monkeypatch.setattr(pool, "allocate_slot", lambda: None)
    array = filled(1)
    got = receiver.send(array)
    array[0] = 2
    assert got[0] == 1


def test_a_forked_process_gives_back_nothing(
    pool: Blocks, receiver: Receiver, another: Receiver
) -> None:
    mine = filled(1)
    sent = receiver.send(np.full(SIZE, 2, np.uint8))
    receiver.got.clear()
    child = os.fork()
    if child == 0:
        del mine, sent
        gc.collect()
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
    next_loan = filled(3)
    came = another.send(np.full(SIZE, 4, np.uint8))
    assert is_on_a_block(pool, next_loan)
    assert [array[0] for array in (mine, sent, next_loan, came)] == [1, 2, 3, 4]
