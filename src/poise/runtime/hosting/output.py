"""Keeps what components write, in a file and the one before, beside passing it on."""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from hashlib import blake2s
from io import TextIOBase
from pathlib import Path
from typing import Any, TextIO

from poise.clock import wall_time
from poise.runtime._calls import called
from poise.threads import SHOWN_FOR
from poise.wire.records.request_records import OutputLine, OutputLines, ReadOutput

LARGEST = 256 << 10
"""When a file is larger, another is begun [bytes]; of a container two are kept."""
LONGEST = 4_096
"""A longer line is cut [characters]."""
_TAIL = 8 * LONGEST
"""No line is longer [bytes]."""
_BEING_WRITTEN = 50_000_000
"""What was written less long ago is told the next time, in its order [ns]."""
_AHEAD = 1_000_000_000
"""What is so much later than now is of before the clock was set back [ns]."""
_NOW, _BEFORE = ".output", ".output-before"
_LOGGERS = "poise.component."
_here = threading.local()


def write_as(component: str) -> None:
    """Let what this thread writes from now on, but in calls, be a component's."""
    _here.component = component


@contextlib.contextmanager
def writing_as(component: str) -> Iterator[None]:
    """Let what this thread writes in a block be a component's."""
    before = getattr(_here, "component", "")
    write_as(component)
    try:
        yield
    finally:
        write_as(before)


class OutputFile:
    """Where the lines of a container are kept. Any thread may add to it."""

    def __init__(self, folder: Path, container: str) -> None:
        name = blake2s(container.encode(), digest_size=8).hexdigest()
        self._path = folder / f"{name}{_NOW}"
        self._container = container
        self._lock = threading.RLock()  # a destructor may write amid a line
        self._at = 0
        self._fd = -1
        self._size = 0
        self._is_cut_short = False
        self._lost: dict[str, tuple[str, float]] = {}

    def add(self, text: str, component: str = "") -> None:
        """Add a line, of the component that writes it unless another is named."""
        component = component or called() or getattr(_here, "component", "")
        component = component or self._container
        with self._lock:
            try:
                if self._fd < 0:
                    self._open()
                # no two lines at one moment, so that none is told twice or never
                self._at = max(self._at + 1, int(wall_time() * 1e9))
                line = f"{self._at}\t{component}\t{text[:LONGEST]}\n"
                self._write(line.encode(errors="replace"))
                if self._size > LARGEST:
                    self._begin_another()
            except OSError as error:  # the component goes on; all was passed on
                self.note_lost("kept", error)

    def note_lost(self, where: str, error: OSError) -> None:
        """Note that what was written is not `where` it should be."""
        self._lost[where] = str(error), time.monotonic()

    def trouble(self) -> str:
        """Return what was lost within `SHOWN_FOR`, and why; else nothing."""
        since = time.monotonic() - SHOWN_FOR
        parts = [
            f"what container '{self._container}' writes is not {where}: {why}"
            for where, (why, at) in sorted(self._lost.copy().items())
            if at > since
        ]
        return "; ".join(parts)

    def unlock(self) -> None:
        """Let a process that was forked write: who held the lock is not there."""
        self._lock = threading.RLock()

    def _write(self, line: bytes) -> None:
        """Add a line, and end one that was cut short before; raises OSError."""
        data = b"\n" * self._is_cut_short + line
        written = os.write(self._fd, data)
        self._size += written
        self._is_cut_short = written < len(data)
        if self._is_cut_short:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def _begin_another(self) -> None:
        # the number is free once it is closed, and may be a component's the next moment
        full, self._fd = self._fd, -1
        try:
            with contextlib.suppress(FileNotFoundError):  # somebody removed it
                self._path.rename(self._path.with_suffix(_BEFORE))
            self._open()
        finally:
            os.close(full)

    def _open(self) -> None:
        self._fd = os.open(self._path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o600)
        self._size = os.fstat(self._fd).st_size
        # what a process before wrote may be of before the clock was set back
        whole = os.pread(self._fd, _TAIL, max(0, self._size - _TAIL)).split(b"\n")
        self._is_cut_short = bool(whole[-1])
        moments = [each.partition(b"\t")[0] for each in whole[self._size > _TAIL :]]
        self._at = max([self._at, *(int(at) for at in moments if at.isdigit())])


class KeptStream(TextIOBase):
    """Standard output or error: passes all on, and keeps it by lines."""

    def __init__(self, stream: TextIO, file: OutputFile) -> None:
        self._stream = stream
        self._file = file
        self._line = threading.local()

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401, as the stream's
        """Return what else the stream has, such as its `buffer`."""
        return getattr(self._stream, name)

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """The stream's encoding."""
        return self._stream.encoding

    @property
    def errors(self) -> str | None:  # type: ignore[override]
        """What the stream does with what it cannot encode."""
        return self._stream.errors

    def writable(self) -> bool:
        """Return True."""
        return True

    def write(self, text: str) -> int:
        """Pass text on; keep each line that is complete."""
        self._pass_on(lambda: self._stream.write(text))
        *lines, unended = (getattr(self._line, "text", "") + text).split("\n")
        for line in lines:
            self._file.add(line)
        self._line.text = unended[:LONGEST]
        return len(text)

    def flush(self) -> None:
        """Pass on what waits."""
        self._pass_on(self._stream.flush)

    def trouble(self) -> str:
        """Return why what is written is lost; empty: it is not."""
        return self._file.trouble()

    def fileno(self) -> int:
        """Return the descriptor of the stream."""
        return self._stream.fileno()

    def isatty(self) -> bool:
        """Return whether the stream is a terminal."""
        return self._stream.isatty()

    def _pass_on(self, how: Callable[[], object]) -> None:
        try:
            how()
        except OSError as error:  # its disk is full, say; the component goes on
            self._file.note_lost("in the agent's log", error)


class _KeptLog(logging.Handler):
    """Keeps what a component's own logger says as its, whichever thread runs that."""

    def __init__(self, file: OutputFile) -> None:
        super().__init__()
        self._file = file

    def emit(self, record: logging.LogRecord) -> None:
        is_own = record.name.startswith(_LOGGERS)
        component = record.name.removeprefix(_LOGGERS) if is_own else ""
        try:
            for line in self.format(record).split("\n"):
                self._file.add(line, component)
        except Exception:  # noqa: BLE001, what is logged is the user's
            self.handleError(record)


def keep_output(folder: Path, container: str) -> None:
    """Keep what this process writes from now on, also what it logs."""
    file = OutputFile(folder, container)
    os.register_at_fork(after_in_child=file.unlock)
    sys.stdout = KeptStream(sys.stdout, file)
    sys.stderr = KeptStream(sys.stderr, file)
    root = logging.getLogger()
    if root.handlers:  # they pass on to what was standard error, with the time
        kept = _KeptLog(file)
        kept.setFormatter(logging.Formatter("%(levelname)s %(name)s: %(message)s"))
        root.addHandler(kept)


def output_trouble() -> str:
    """Return why what this process writes is lost; empty: it is not."""
    return sys.stdout.trouble() if isinstance(sys.stdout, KeptStream) else ""


def read_output(folder: Path, request: ReadOutput) -> OutputLines:
    """Return what the containers of a folder have written."""
    now = int(wall_time() * 1e9)
    # files tell when they were written by the clock as it is now
    unread = 0 if request.after > now else request.after
    # a set: a file that is renamed meanwhile is read twice
    matching = {
        line
        for ending in (_NOW, _BEFORE)
        for path in folder.glob(f"*{ending}")
        for line in _lines(path, unread)
        if request.after < line.at
        and not now - _BEING_WRITTEN < line.at <= now + _AHEAD
        and request.component in {"", line.component}
    }
    lines = sorted(matching, key=lambda line: line.at)
    last = lines[max(0, len(lines) - request.most) :]
    return OutputLines(lines=tuple(last), omitted=len(lines) - len(last), now=now)


def forget_output(folder: Path) -> None:
    """Remove what the containers of a folder have written."""
    for ending in (_NOW, _BEFORE):
        for path in folder.glob(f"*{ending}"):
            path.unlink(missing_ok=True)


def _lines(path: Path, after: int) -> Iterator[OutputLine]:
    try:
        if path.stat().st_mtime_ns + _BEING_WRITTEN < after:
            return  # nothing new in it
        text = path.read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:  # it was just renamed: the next time
        return
    for line in text.split("\n"):
        at, _, rest = line.partition("\t")
        component, is_whole, message = rest.partition("\t")
        if at.isdecimal() and is_whole:  # a full disk cuts lines short
            yield OutputLine(at=int(at), component=component, text=message)
