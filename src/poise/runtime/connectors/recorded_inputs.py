"""Records what comes over a connector, at its receiving end."""

from __future__ import annotations

import logging
import os
import secrets
from pathlib import Path

from poise.clock import wall_time
from poise.errors import RunError
from poise.wire.connections.connection_server import Handler
from poise.wire.frame import Frame, Kind, Pieces
from poise.wire.recording_file import Input, McapFile

log = logging.getLogger(__name__)

MOST = 1 << 28
"""Of one connector at most so much is recorded [bytes]; later entries are left out."""
_RECORDED = {Kind.MESSAGE, Kind.CALL, Kind.ONEWAY}
_RESULT_BODY = 1


class InputFile:
    """A file for the inputs of one connector's end: whole however its process ends."""

    def __init__(self, folder: Path, source: str) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        name = f"{source}-{os.getpid()}-{secrets.token_hex(4)}.mcap"
        self._file = McapFile(folder / name, "", at_once=True)
        self._source = source
        self._size = 0
        self._has_ended = False

    def handler(self, handle: Handler) -> Handler:
        """Return a handler that also records messages and calls."""

        def handle_and_record(received: Frame) -> Pieces | None:
            at = wall_time()
            answer = handle(received)
            if received.kind in _RECORDED:
                self._add(at, received, answer)
            return answer

        return handle_and_record

    def _add(self, at: float, received: Frame, answer: Pieces | None) -> None:
        body, buffers = bytes(received.body), bytes(received.buffers)
        if self._has_ended:
            return
        self._size += len(body) + len(buffers)
        if self._size > MOST:
            self._end(f"it may have {MOST} B")
            return
        tag = None if received.kind is Kind.MESSAGE else received.tag
        entry = Input(self._source, at, body, buffers, tag, _result(answer))
        try:
            self._file.add_record(entry, at)
        except RunError as error:
            self._end(str(error))

    def _end(self, why: str) -> None:
        self._has_ended = True
        log.warning("%s: nothing more is recorded: %s", self._file.path, why)

    def close(self) -> None:
        """Close the file; harmless when repeated."""
        self._file.close()


def _result(answer: Pieces | None) -> bytes:
    """Return the encoded result of an answer; empty when it failed."""
    if answer is None or bytes(answer[0])[1] != Kind.RESULT:
        return b""
    return bytes(answer[_RESULT_BODY])
