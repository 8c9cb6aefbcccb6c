"""The file in which a receiving end records what comes over connectors.

Each entry is one write at the end of the file, behind its length: so several processes
of a computer may use one file.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from pathlib import Path

import msgspec

from poise.wire.connections.connection_server import Handler
from poise.wire.frame import Frame, Kind, Pieces
from poise.wire.recording_file import Input

log = logging.getLogger(__name__)

MOST = 1 << 28
"""The largest file [bytes]; later entries are left out."""
_RECORDED = {Kind.MESSAGE, Kind.CALL, Kind.ONEWAY}
_LENGTH = 4
_RESULT_BODY = 1


class InputFile:
    """The end of the file; any thread may add to it."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._fd = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
        self._lock = threading.Lock()
        self._is_closed = False

    def add(self, entry: Input) -> None:
        """Append an entry, unless the file is full or closed."""
        data = msgspec.msgpack.encode(entry)
        with self._lock:
            if self._is_closed:
                return
            try:
                self._append(len(data).to_bytes(_LENGTH, "little") + data)
            except OSError as error:
                log.warning("%s: nothing more is recorded: %s", self._path, error)
                self._close()

    def _append(self, data: bytes) -> None:
        if os.fstat(self._fd).st_size + len(data) > MOST:
            raise OSError(f"it may have {MOST} B")
        if os.write(self._fd, data) < len(data):
            raise OSError("the disk is full")

    def close(self) -> None:
        """Close the file; harmless when repeated."""
        with self._lock:
            self._close()

    def _close(self) -> None:
        if not self._is_closed:
            self._is_closed = True
            os.close(self._fd)


def recording(handler: Handler, source: str, file: InputFile) -> Handler:
    """Return a handler that also records messages and calls.

    Parameters
    ----------
    source
        ``component.port`` that publishes or calls.
    """

    def handle(received: Frame) -> Pieces | None:
        at = time.monotonic()
        answer = handler(received)
        if received.kind in _RECORDED:
            body, buffers = bytes(received.body), bytes(received.buffers)
            tag = None if received.kind is Kind.MESSAGE else received.tag
            file.add(Input(source, at, body, buffers, tag, _result(answer)))
        return answer

    return handle


def _result(answer: Pieces | None) -> bytes:
    """Return the encoded result of an answer; empty when it failed."""
    if answer is None or bytes(answer[0])[1] != Kind.RESULT:
        return b""
    return bytes(answer[_RESULT_BODY])


def read_inputs(path: Path) -> list[Input]:
    """Return the recorded inputs, oldest first, without a truncated one at the end.

    The first came at 0 s.
    """
    data = path.read_bytes()
    found, at = [], 0
    decoder = msgspec.msgpack.Decoder(Input)
    while at + _LENGTH <= len(data):
        length = int.from_bytes(data[at : at + _LENGTH], "little")
        entry = data[at + _LENGTH : at + _LENGTH + length]
        at += _LENGTH + length
        if len(entry) == length:
            found.append(decoder.decode(entry))
    found.sort(key=lambda each: each.at)
    return [msgspec.structs.replace(e, at=e.at - found[0].at) for e in found]
