"""What a component forks keeps no connection open."""

from __future__ import annotations

import os
import socket

import pytest

from poise.wire.address import keep_private
from poise.wire.connections.blocks import BLOCKS
from poise.wire.connections.connection import Connection

pytestmark = pytest.mark.slow


def test_the_other_end_sees_the_end_though_a_forked_process_lives() -> None:
    ours, theirs = socket.socketpair()
    keep_private(ours)
    theirs.settimeout(20.0)
    lives, goes_on = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(goes_on)
        os.read(lives, 1)
        os._exit(0)
    ours.close()
    with theirs:
        assert theirs.recv(1) == b""
    os.close(goes_on)
    os.close(lives)
    assert os.waitpid(child, 0)[1] == 0


def test_a_forked_process_that_sends_gets_an_error() -> None:
    """Not the file that has taken the number of the connection meanwhile."""
    ours, theirs = socket.socketpair()
    keep_private(ours)
    child = os.fork()
    if child == 0:
        try:
            ours.sendall(b"x")
        except OSError:
            os._exit(0)
        os._exit(1)
    assert os.waitpid(child, 0)[1] == 0
    ours.close()
    assert theirs.recv(1) == b""
    theirs.close()


def test_a_forked_process_has_no_connection_of_its_container() -> None:
    ours, theirs = socket.socketpair()
    with theirs:
        connection = Connection(ours)
        number = ours.fileno()
        child = os.fork()
        if child == 0:
            try:
                os.write(number, b"x")
            except OSError:
                os._exit(0)
            os._exit(1)
        assert os.waitpid(child, 0)[1] == 0
        connection.close()


def test_a_forked_process_writes_to_no_block_of_its_container() -> None:
    block = BLOCKS.allocate(1 << 20, 1)
    assert block is not None
    block.release(1)
    child = os.fork()
    if child == 0:
        its = BLOCKS.allocate(1 << 20, 1)
        os._exit(int(its is None or block.is_lent(1)))
    assert os.waitpid(child, 0)[1] == 0
