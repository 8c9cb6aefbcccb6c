"""Gathers the samples of a computer's containers and tells them, in one message."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import msgspec
from msgspec import Struct

from poise.runtime.sampler import Page, sample_path

log = logging.getLogger(__name__)


class _Encoded(Struct, frozen=True, array_like=True):
    """An `AgentSample` whose containers are encoded already."""

    computer: str
    at: float
    cpu: float
    containers: tuple[msgspec.Raw, ...]


class Collector:
    """A thread of the agent; it wakes once per interval, however many containers.

    Parameters
    ----------
    computer
        Its name.
    folder
        Where containers leave their samples.
    every
        [s]; > 0.
    containers
        Returns name and process number of the containers that run; called on the
        thread.
    publish
        Takes an encoded `poise.wire.samples.AgentSample`; called on the thread.
    """

    def __init__(
        self,
        computer: str,
        folder: Path,
        every: float,
        containers: Callable[[], Iterable[tuple[str, int]]],
        publish: Callable[[bytes], None],
    ) -> None:
        self._computer = computer
        self._folder = folder
        self._every = every
        self._containers = containers
        self._publish = publish
        self._pages: dict[Path, Page] = {}
        self._ended = threading.Event()
        self._encoder = msgspec.msgpack.Encoder()
        self._thread = threading.Thread(
            target=self._main, name="collector", daemon=True
        )

    def start(self) -> None:
        """Begin to collect."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread; harmless when it never started."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join(1.0)
        for page in self._pages.values():
            page.close()

    def _main(self) -> None:
        while not self._ended.wait(self._every):
            self._publish(self._encoder.encode(self._sample()))

    def _sample(self) -> _Encoded:
        paths = {sample_path(self._folder, *each) for each in self._containers()}
        for path in self._pages.keys() - paths:
            self._pages.pop(path).close()
            path.unlink(missing_ok=True)  # a killed container left it
        for path in paths - self._pages.keys():
            self._pages[path] = Page(path)
        bodies = [page.read() for page in self._pages.values()]
        found = [msgspec.Raw(body) for body in bodies if body is not None]
        return _Encoded(
            self._computer, time.monotonic(), time.process_time(), tuple(found)
        )
