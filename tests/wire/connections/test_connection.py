"""Arrays cross a connection in shared memory; no block can crash the receiver."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import gc
import itertools
import os
import random
import resource
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeout
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from poise.errors import Timeout, Unavailable
from poise.wire import frame
from poise.wire.address import peek
from poise.wire.codec import Unreadable, WireError, codec
from poise.wire.connections.blocks import DATA, MOST_BYTES, MOST_LENT, Block, Blocks
from poise.wire.connections.connection import Connection
from poise.wire.frame import LARGEST, FrameKind
from tests.waiting import wait_until

pytestmark = pytest.mark.slow

ANY = codec(Any)
LONG = 20.0
NEW = 1 << 31
BEING_FILLED = 2


@pytest.fixture
def ends() -> Iterator[tuple[Connection, Connection]]:
    """Give the asking end, and the other, at which a thread sends back what comes."""
    ours, theirs = map(Connection, socket.socketpair())

    def serve() -> None:
        with contextlib.suppress(Unavailable):
            while True:
                echo(theirs)

    thread = threading.Thread(target=serve)
    thread.start()
    yield ours, theirs
    ours.end()
    thread.join(LONG)
    ours.close()
    theirs.close()


@pytest.fixture
def far() -> Iterator[tuple[Connection, socket.socket]]:
    """Give a connection over TCP, and the socket at its other end."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        theirs = socket.create_connection(listener.getsockname())
        ours, _ = listener.accept()
    connection = Connection(ours)
    with theirs:
        yield connection, theirs
    connection.close()


def echo(connection: Connection) -> None:
    connection.send(
        frame.segments(ANY, connection.receive().value(ANY), FrameKind.RESULT)
    )


def ask(connection: Connection, value: object) -> Any:
    deadline = time.monotonic() + LONG
    connection.send(frame.segments(ANY, value, FrameKind.CALL, chain=1), deadline)
    return connection.receive(deadline).value(ANY)


def call(value: object) -> Any:
    return frame.segments(ANY, value, FrameKind.CALL)


def image(number: int, size: int = 1 << 20) -> Any:
    return np.full(size, number, np.uint8)


@pytest.mark.parametrize("size", [0, 1, 8000, 8160, 8192, 8193, 100_000, 3_000_000])
def test_brings_bytes_of_any_size(
    ends: tuple[Connection, Connection], size: int
) -> None:
    assert ask(ends[0], bytes(size)) == bytes(size)


@pytest.mark.parametrize("size", [0, 10, 65_535, 65_536, 1_000_000])
def test_brings_arrays_of_any_size(
    ends: tuple[Connection, Connection], size: int
) -> None:
    for number in range(20):
        answer = ask(ends[0], [image(number, size), image(number + 1, size)])
        assert [array.size for array in answer] == [size, size]
        assert all((a == number + i).all() for i, a in enumerate(answer))


def test_received_arrays_cannot_be_written(ends: tuple[Connection, Connection]) -> None:
    with pytest.raises(ValueError, match="read-only"):
        ask(ends[0], image(1))[0] = 2


def test_arrays_that_are_kept_stay_as_they_are(
    ends: tuple[Connection, Connection],
) -> None:
    """More are kept than there are blocks; then the socket carries them."""
    most = 3 * MOST_LENT
    kept = [ask(ends[0], image(number)) for number in range(most)]
    assert all((array == number).all() for number, array in enumerate(kept))
    part = kept[3][10:20]
    del kept
    gc.collect()
    for number in range(100, 100 + most):
        ask(ends[0], image(number))
    assert (part == 3).all()


def test_a_source_whose_credit_nobody_takes_any_more_connects_again(
    ends: tuple[Connection, Connection], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: frame.Frame) -> bool:
        raise RuntimeError("can't start new thread")

    source, target = ends
    failures: list[threading.ExceptHookArgs] = []
    monkeypatch.setattr(threading, "excepthook", failures.append)
    source.follow(fail)
    assert target.send_back(frame.segments(codec(str), "credit", FrameKind.CREDIT))
    wait_until(lambda: source.is_over)
    wait_until(lambda: failures)


def test_arrays_outlive_their_connection() -> None:
    ours, theirs = map(Connection, socket.socketpair())
    echoing = threading.Thread(target=echo, args=(theirs,))
    echoing.start()
    array = ask(ours, image(7))
    echoing.join(LONG)
    ours.close()
    theirs.close()
    assert (array == 7).all()


def test_blocks_are_used_again_when_arrays_are_let_go(
    ends: tuple[Connection, Connection],
) -> None:
    ask(ends[0], image(0))
    before = open_files()
    for number in range(50):
        ask(ends[0], image(number))
    # each end may need one more while an answer is still under way
    assert open_files() <= before + 4


def test_leaves_no_name_in_shared_memory(ends: tuple[Connection, Connection]) -> None:
    def mapped(what: str) -> int:
        return Path("/proc/self/maps").read_text().count(what)

    before = mapped(" /dev/shm/")  # what others on the machine have there is theirs
    lent = ask(ends[0], image(0))
    assert mapped(" /memfd:poise (deleted)") > 0
    assert mapped(" /dev/shm/") == before
    del lent


def test_makes_room_for_larger_arrays(ends: tuple[Connection, Connection]) -> None:
    for exponent in range(16, 25):
        array = ask(ends[0], image(exponent, 1 << exponent))
        assert array.size == 1 << exponent
        assert (array == exponent).all()


def test_a_pool_is_bounded_while_nothing_is_given_back() -> None:
    pool = Blocks()
    for slot in (3, 4):  # one receiver keeps nothing from another
        taken = [pool.allocate(1 << 16, slot) for _ in range(MOST_LENT)]
        assert len({block.number for block in taken if block}) == MOST_LENT
        assert pool.allocate(1 << 16, slot) is None


def test_a_pool_makes_no_block_that_is_too_large() -> None:
    pool = Blocks()
    assert pool.allocate(MOST_BYTES + 1, 3) is None


def test_blocks_go_with_the_last_connection() -> None:
    pool = Blocks()
    first, second = pool.allocate_slot(), pool.allocate_slot()
    assert first is not None
    assert second is not None
    before = open_files()
    block = pool.allocate(1 << 16, first)
    assert block is not None
    block.release(first)
    del block
    pool.free_slot(first)
    assert open_files() == before + 2  # a map has a file, too
    pool.free_slot(second)
    assert open_files() == before


def open_files() -> int:
    """Return how many are of blocks; threads of earlier tests may close others."""
    count = 0
    for file in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # closed since
            count += str(file.readlink()).startswith("/memfd:poise")
    return count


def head(length: int, block: int, used: int = 0) -> bytes:
    return struct.pack("<IIQ", length, block, used)[: 16 if block else 8]


@pytest.fixture
def raw() -> Iterator[tuple[socket.socket, Connection]]:
    """Give a socket to write anything to, and the connection that gets it."""
    ours, theirs = socket.socketpair()
    ours.settimeout(LONG)
    connection = Connection(theirs)
    yield ours, connection
    ours.close()
    connection.close()


@pytest.mark.parametrize(
    ("sent", "why"),
    [
        (head(3, 0) + b"abc", "cut short"),
        (head((1 << 30) + 1, 0), "is the largest"),
        (head(24, 3, 10) + bytes(24), "no shared block 3"),
        (head(0, NEW | 1, 1 << 16), "no file came for a shared block 1"),
    ],
)
def test_refuses_what_is_no_frame(
    raw: tuple[socket.socket, Connection], sent: bytes, why: str
) -> None:
    raw[0].sendall(sent)
    with pytest.raises(WireError, match=why):
        raw[1].receive(time.monotonic() + LONG)


@pytest.mark.parametrize(
    ("kind", "why"),
    [
        ("unsealed", "may shrink"),
        ("empty", f"block of -{DATA} B"),
        ("no memory", "cannot be mapped"),
        ("slot", "with slot 5000"),
    ],
)
def test_refuses_a_block_that_could_crash_it(
    raw: tuple[socket.socket, Connection], kind: str, why: str
) -> None:
    good = Block(1, 1 << 16)
    seals = os.MFD_ALLOW_SEALING
    files = {
        "unsealed": os.memfd_create("test", seals),
        "empty": os.memfd_create("test", seals),
        "no memory": os.open("/dev/null", os.O_RDWR),
        "slot": os.dup(good.file),
    }
    all_seals = fcntl.fcntl(good.file, fcntl.F_GET_SEALS)
    fcntl.fcntl(files["empty"], fcntl.F_ADD_SEALS, all_seals)
    slot = 5000 if kind == "slot" else 1
    socket.send_fds(raw[0], [head(0, NEW | slot << 8 | 1, 1)], [files[kind]])
    with pytest.raises(WireError, match=why):
        raw[1].receive(time.monotonic() + LONG)
    for file in files.values():
        os.close(file)


def test_who_is_gone_amid_sending_a_block_is_gone(
    raw: tuple[socket.socket, Connection],
) -> None:
    before = open_files()
    block = Block(1, 1 << 16)
    socket.send_fds(raw[0], [head(24, NEW | 1 << 8 | 1, 10)], [block.file])
    raw[0].shutdown(socket.SHUT_WR)
    with pytest.raises(Unavailable, match="is gone"):
        raw[1].receive(time.monotonic() + LONG)
    del block
    raw[1].close()
    raw[1].__init__(raw[0])  # type: ignore[misc]
    assert open_files() <= before  # the file that came is closed


def test_refuses_more_of_a_block_than_it_has(
    raw: tuple[socket.socket, Connection],
) -> None:
    block = Block(1, 1 << 16)
    said = head(24, NEW | 1 << 8 | 1, block.capacity + 1) + bytes(24)
    socket.send_fds(raw[0], [said], [block.file])
    with pytest.raises(WireError, match="65537 B announced in a block of 65536 B"):
        raw[1].receive(time.monotonic() + LONG)


def test_over_tcp_arrays_come_inline(far: tuple[Connection, socket.socket]) -> None:
    connection, sock = far
    other = Connection(sock)
    sent = [image(1, 3 << 20), image(2, 70_000)]
    pieces = frame.segments(ANY, sent, FrameKind.CALL)
    sender = threading.Thread(target=other.send, args=(pieces,))
    sender.start()
    came = connection.receive().value(ANY)
    sender.join(LONG)
    assert [(a == b).all() for a, b in zip(came, sent, strict=True)] == [True, True]
    assert not any(array.flags.writeable or array.flags.owndata for array in came)
    assert [connection.has_blocks, other.has_blocks] == [False, False]


@pytest.mark.parametrize("block", [1, NEW | 1])
def test_over_tcp_no_shared_memory_is_taken(
    far: tuple[Connection, socket.socket], block: int
) -> None:
    connection, sock = far
    sock.sendall(struct.pack("<IIQ", 0, block, 1 << 16))
    with pytest.raises(Unreadable, match="was announced over TCP"):
        connection.receive()


def test_what_is_announced_takes_no_memory_before_it_comes(
    far: tuple[Connection, socket.socket],
) -> None:
    connection, sock = far
    sock.sendall(struct.pack("<II", LARGEST, 0) + bytes(1 << 20))
    before = resident()
    with pytest.raises(Timeout):
        connection.receive(time.monotonic() + 0.05)
    assert resident() - before < 1 << 26  # a gigabyte was announced


def resident() -> int:
    """Return how much memory this process has used at most [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10


@pytest.mark.parametrize("size", [1 << 16, (1 << 16) + 7, 3_000_001])
def test_arrays_of_one_frame_lie_end_to_end_on_a_block(
    ends: tuple[Connection, Connection], size: int
) -> None:
    """Also when the body is of any length, and the arrays are not."""
    numbers = np.random.default_rng(size).integers(256, size=2 * size, dtype=np.uint8)
    for length in range(17):
        sent: list[Any] = [
            "x" * length,
            numbers[:size],
            numbers[1 : size + 1],
            numbers[size:],
        ]
        answer = ask(ends[0], sent)
        assert answer[0] == sent[0]
        pairs = zip(sent[1:], answer[1:], strict=True)
        assert all(np.array_equal(one, other) for one, other in pairs)


Known = tuple[Connection, Connection, Block]


@pytest.fixture
def known(monkeypatch: pytest.MonkeyPatch) -> Iterator[Known]:
    """Give two ends, and a block of the first one that the other knows."""
    monkeypatch.setattr("poise.wire.connections.connection.BLOCKS", Blocks())
    ours, theirs = map(Connection, socket.socketpair())
    thread = threading.Thread(target=ours.send, args=(call(image(1)),))
    thread.start()
    theirs.receive()
    thread.join(LONG)
    block = ours._known[1]
    yield ours, theirs, block
    ours.close()
    theirs.close()


def test_a_block_is_lent_until_the_last_view_is_gone(known: Known) -> None:
    ours, theirs, block = known
    assert block.is_free()
    ours.send(call(image(1)))
    part = theirs.receive().value(ANY)[7:9]
    assert not block.is_free()
    del part
    assert block.is_free()


def test_a_call_that_got_no_answer_takes_no_block_back(known: Known) -> None:
    """The other end has it, and may read it for as long as it likes."""
    ours, theirs, block = known
    with pytest.raises(Timeout, match="no answer"):
        ours.ask(call(image(5)), time.monotonic() + 0.01)
    assert not block.is_free()
    assert (theirs.receive().value(ANY) == 5).all()


def test_a_call_that_did_not_go_out_gives_its_block_back(known: Known) -> None:
    ours, theirs, block = known
    theirs.close()
    assert ours.ask(call(image(5)), time.monotonic() + LONG) is None
    assert block.is_free()


def test_a_frame_on_more_than_its_block_is_refused(known: Known) -> None:
    ours, theirs, block = known
    head = frame.segments(ANY, None, FrameKind.CALL)
    deadline = time.monotonic() + LONG
    ours._channel.send(head, deadline, LARGEST, block.number, block.capacity + 1)
    with pytest.raises(WireError, match="B announced in a block of"):
        theirs.receive()


def test_arrays_come_inline_when_no_block_can_be_had(
    ends: tuple[Connection, Connection], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> int:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr(os, "memfd_create", fail)
    assert bool((ask(ends[0], image(1)) == image(1)).all())
    assert not ends[0].has_blocks


SENDER = """
import sys, socket
from typing import Any
import numpy as np
from poise.wire import frame
from poise.wire.codec import codec
from poise.wire.connections.connection import Connection
from poise.wire.frame import FrameKind

connection = Connection(socket.socket(fileno=int(sys.argv[1])))
array = np.empty(1 << 18, np.uint32)
for number in range(10_000_000):
    array[:] = number
    connection.send(frame.segments(codec(Any), array, FrameKind.MESSAGE, number=number))
"""


@pytest.mark.parametrize("seed", range(5))
def test_a_sender_that_is_killed_at_any_point_leaves_whole_frames(seed: int) -> None:
    ours, theirs = socket.socketpair()
    argv = [sys.executable, "-c", SENDER, str(theirs.fileno())]
    process = subprocess.Popen(argv, pass_fds=[theirs.fileno()])
    theirs.close()
    connection = Connection(ours)
    assert is_whole(connection, 0)
    after = random.Random(seed).uniform(0, 0.02)
    threading.Timer(after, process.kill).start()
    with pytest.raises(Unavailable):
        all(is_whole(connection, number) for number in itertools.count(1))
    process.wait(LONG)
    connection.close()


def is_whole(connection: Connection, number: int) -> bool:
    received = connection.receive(time.monotonic() + LONG)
    assert received.number == number
    assert (received.value(ANY) == number).all()
    return True


@pytest.fixture
def half(known: Known) -> Known:
    """Send a frame on a block that is not filled yet."""
    ours, _, block = known
    slot = ours._slot
    assert slot is not None
    block.lend(slot)
    block.memory[slot] = BEING_FILLED
    head = frame.segments(ANY, image(1), FrameKind.CALL)[:2]
    where = slot << 8 | block.number
    ours._channel.send(head, time.monotonic() + LONG, LARGEST, where, 1 << 20)
    return known


def test_who_comes_before_the_rest_waits_for_it(half: Known) -> None:
    ours, theirs, block = half
    with ThreadPoolExecutor(1) as pool:
        came = pool.submit(theirs.receive, time.monotonic() + LONG)
        with pytest.raises(FutureTimeout):
            came.result(0.01)
        block.memory[DATA : DATA + (1 << 20)] = b"\x07" * (1 << 20)
        assert ours._slot is not None
        block.lend(ours._slot)
        assert (came.result(LONG).value(ANY) == 7).all()


def test_a_sender_that_goes_amid_copying_leaves_no_frame(half: Known) -> None:
    half[0].end()
    with pytest.raises(Unavailable, match="closed the connection"):
        half[1].receive(time.monotonic() + LONG)


def test_the_rest_has_a_limit(half: Known) -> None:
    with pytest.raises(Timeout, match="in time"):
        half[1].receive(time.monotonic() + 0.01)


def test_a_connection_is_drained_when_all_is_read_and_nothing_comes() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        theirs = socket.create_connection(server.getsockname())
        ours = Connection(server.accept()[0])
    theirs.sendall(bytes(3))
    wait_until(lambda: peek(ours._connection, 3) == bytes(3))
    assert not ours.is_drained(0.0)
    ours._connection.recv(3)
    assert ours.is_drained(0.0)
    assert not ours.is_drained(LONG)
    ours.close()
    assert ours.is_drained(LONG)
    theirs.close()
