"""iceoryx2: request/response in shared memory, each signalled by a listener.

The sender copies into memory that iceoryx2 lends it, and the receiver reads there.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import iceoryx2

from benchmarks.calls.timing import Trips, payload, read, timed

LARGEST = 6 << 20


class Node:
    """One end: its service and the two events."""

    def __init__(self, folder: Path) -> None:
        iceoryx2.set_log_level(iceoryx2.LogLevel.Error)
        self.node = iceoryx2.NodeBuilder.new().create(iceoryx2.ServiceType.Ipc)
        self._folder = folder.name
        piece = iceoryx2.Slice[ctypes.c_uint8]
        self.service = (
            self._builder("calls").request_response(piece, piece).open_or_create()
        )
        self.requested = self._builder("requested").event().open_or_create()
        self.answered = self._builder("answered").event().open_or_create()
        self._wait = iceoryx2.Duration.from_secs(10)

    def _builder(self, name: str) -> Any:
        return self.node.service_builder(
            iceoryx2.ServiceName.new(f"{self._folder}/{name}")
        )

    def wait_for(self, listener: Any, receive: Callable[[], Any]) -> Any:
        """Return what is received, after as many events as it takes."""
        while (received := receive()) is None:
            listener.timed_wait(self._wait)
        return received


def copy(target: Any, address: int, size: int) -> Any:
    """Fill loaned memory and return it ready to be sent."""
    ctypes.memmove(target.payload_ptr, address, size)
    return target.assume_init()


def serve(folder: Path, ready: Callable[[], None]) -> None:
    """Send back what comes."""
    node = Node(folder)
    server = node.service.server_builder().initial_max_slice_len(LARGEST).create()
    listener = node.requested.listener_builder().create()
    notifier = node.answered.notifier_builder().create()
    ready()
    while True:
        request = node.wait_for(listener, server.receive)
        size = request.payload().len()
        answer = request.loan_slice_uninit(size)
        copy(answer, request.payload_ptr, size).send()
        notifier.notify()
        request.delete()


@contextmanager
def connect(folder: Path) -> Iterator[Trips]:
    """Give the round trips."""
    node = Node(folder)
    client = node.service.client_builder().initial_max_slice_len(LARGEST).create()
    listener = node.answered.listener_builder().create()
    notifier = node.requested.notifier_builder().create()

    def made(size: int) -> Any:
        return (ctypes.c_uint8 * size).from_buffer_copy(payload(size))

    def echo(data: Any) -> None:
        size = len(data)
        request = client.loan_slice_uninit(size)
        pending = copy(request, ctypes.addressof(data), size).send()
        notifier.notify()
        answer = node.wait_for(listener, pending.receive)
        read((ctypes.c_uint8 * size).from_address(answer.payload_ptr))
        answer.delete()
        pending.delete()

    yield lambda size, count: timed(echo, made(size), count)
    time.sleep(0)
