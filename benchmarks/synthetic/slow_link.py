"""A slow network link to a web server of this computer: a TCP proxy."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Iterator
from types import TracebackType
from typing import Self
from urllib.parse import urlsplit

_CHUNK = 1400
"""So much is carried at a time [bytes]."""
_MOST_CHUNKS = 1000


class SlowLink:
    """Carries connections, as a link with a rate and a delay does.

    Use it as a context manager. What is on the way is bounded, so the server feels a
    link that takes no more.

    Parameters
    ----------
    to
        The address of the server: ``http://127.0.0.1:7480/``.

    Attributes
    ----------
    rate
        All connections together get so much each way [bytes/s]; 0: nothing passes.
    delay
        One way [s].
    address
        Where the server is at the other end of the link.
    """

    def __init__(self, to: str) -> None:
        self.rate = float("inf")
        self.delay = 0.0
        self.address = ""
        self._to = urlsplit(to)
        self._lanes = asyncio.Lock(), asyncio.Lock()
        self._writers: set[asyncio.StreamWriter] = set()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        begin = asyncio.start_server(self._carry, "127.0.0.1", 0, limit=_CHUNK)
        self._server = asyncio.run_coroutine_threadsafe(begin, self._loop).result()
        host, port = self._server.sockets[0].getsockname()
        self.address = f"http://{host}:{port}/"
        return self

    def __exit__(
        self,
        _type: type[BaseException] | None,
        _error: BaseException | None,
        _traceback: TracebackType | None,
    ) -> None:
        asyncio.run_coroutine_threadsafe(self._end(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def cut(self) -> None:
        """End all connections; others may be made at once."""
        self._loop.call_soon_threadsafe(self._close)

    def _close(self) -> None:
        for writer in self._writers:
            writer.close()

    async def _end(self) -> None:
        self._server.close()
        self.rate = float("inf")
        self._close()
        others = asyncio.all_tasks() - {asyncio.current_task()}
        await asyncio.gather(*others, return_exceptions=True)

    async def _carry(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        with self._known(writer):
            far_reader, far_writer = await asyncio.open_connection(
                self._to.hostname, self._to.port, limit=_CHUNK
            )
            with self._known(far_writer):
                there, back = self._lanes
                await asyncio.gather(
                    self._pass(reader, far_writer, there),
                    self._pass(far_reader, writer, back),
                )

    @contextlib.contextmanager
    def _known(self, writer: asyncio.StreamWriter) -> Iterator[None]:
        self._writers.add(writer)
        try:
            yield
        finally:
            self._writers.discard(writer)
            writer.close()

    async def _pass(
        self,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        lane: asyncio.Lock,
    ) -> None:
        """Carry one way, until one of the ends closes."""
        loop = asyncio.get_running_loop()
        on_the_way: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue(_MOST_CHUNKS)

        async def arrive() -> None:
            while True:
                due, data = await on_the_way.get()
                await asyncio.sleep(max(0.0, due - loop.time()))
                if not data:
                    break
                writer.write(data)
                await writer.drain()
            writer.close()

        async def leave() -> None:
            while True:
                data = await reader.read(_CHUNK)
                async with lane:
                    while not self.rate:  # noqa: ASYNC110, any thread sets it
                        await asyncio.sleep(0.01)
                    await asyncio.sleep(len(data) / self.rate)
                await on_the_way.put((loop.time() + self.delay, data))
                if not data:
                    break

        try:
            async with asyncio.TaskGroup() as both:
                both.create_task(arrive())
                both.create_task(leave())
        except* ConnectionError:
            pass
