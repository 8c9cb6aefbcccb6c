"""Reports errors of users' code: by its lines, and not too often."""

from __future__ import annotations

import concurrent.futures
import importlib
import logging
from collections.abc import Hashable
from pathlib import Path
from traceback import (
    StackSummary,
    TracebackException,
    extract_tb,
    format_exception_only,
)

from msgspec.structs import replace

import poise
from poise.clock import wall_time
from poise.errors import PoiseError, Sparing, encodable
from poise.wire.codec import WireError, codec
from poise.wire.records.status_records import (
    ComponentStatus,
    ContainerStatus,
    ErrorCount,
)

_OURS = (
    *(
        f"{Path(folder).absolute()}/"
        for folder in (
            *poise.__path__,
            *importlib.__path__,
            *concurrent.futures.__path__,
        )
    ),
    "<frozen importlib",
)

MOST_DISTINCT = 20
"""The most lines whose errors are counted apart; others count with the last one."""


class Errors:
    """What a component's code raised: how often, and the last; logged sparingly."""

    def __init__(self, component: str) -> None:
        self._log = logging.getLogger(f"poise.component.{component}")
        self.count = 0
        self.last = ""
        self._distinct: dict[Hashable, ErrorCount] = {}
        self._sparing = Sparing(self._log)

    def note(self, where: str, error: BaseException, now: float) -> None:
        """Count an error that a method or hook raised at `now` [s]."""
        self.count += 1
        self.last = traceback_of(error)
        self._add(where, error)
        more = self._sparing.more((where, type(error)), now)
        if more is not None:
            self._log.error("%s%s: %s", where, more, self.last)

    def counts(self) -> tuple[ErrorCount, ...]:
        """Return the errors by line and type, in the order in which they first came."""
        return tuple(self._distinct.values())

    def _add(self, where: str, error: BaseException) -> None:
        lines = extract_tb(error.__traceback__)
        line = next(reversed(_outside(lines) or lines), None)
        place = line and (line.filename, line.lineno)
        key: Hashable = where, type(error), place
        if key not in self._distinct and len(self._distinct) >= MOST_DISTINCT:
            key = next(reversed(self._distinct))
        before = self._distinct.get(key) or ErrorCount(
            where=where, text=self.last, first=wall_time(), count=0
        )
        self._distinct[key] = replace(before, count=before.count + 1)


def traceback_of(error: BaseException) -> str:
    """Return an error as text, with the traceback lines that lie outside Poise."""
    text = TracebackException.from_exception(error)
    if _keep_outside(text):
        return encodable("".join(text.format()).rstrip())
    whole = TracebackException.from_exception(error)
    is_ours = isinstance(error, PoiseError)
    return encodable(str(error) if is_ours else "".join(whole.format()))


def brief_traceback(error: BaseException) -> str:
    """Return what an error says, then the lines outside Poise that it came through."""
    lines = _outside(extract_tb(error.__traceback__)).format()
    message = "".join(format_exception_only(error)).strip()
    return encodable("".join([f"{message}\n", *lines]).rstrip())


def sendable(status: ContainerStatus) -> ContainerStatus:
    """Return a status without the texts of components that cannot be sent."""
    components = tuple(map(_sendable, status.components))
    return replace(status, trouble=encodable(status.trouble), components=components)


def _sendable(status: ComponentStatus) -> ComponentStatus:
    try:
        codec(ComponentStatus).encode(status)
    except WireError as error:
        return replace(
            status,
            error=f"the texts of its status cannot be sent: {error}",
            error_counts=(),
            work={},
            task_requests=(),
            measures={},
        )
    return status


def _keep_outside(text: TracebackException) -> bool:
    """Cut the rest off, and causes that are all of it; whether anything is left."""
    text.stack = _outside(text.stack)
    if text.__cause__ is not None and not _keep_outside(text.__cause__):
        text.__cause__, text.__suppress_context__ = None, True
    if text.__context__ is not None and (
        text.__suppress_context__ or not _keep_outside(text.__context__)
    ):
        text.__context__ = None
    return bool(text.stack or text.__cause__ or text.__context__)


def _outside(stack: StackSummary) -> StackSummary:
    return StackSummary.from_list(
        [line for line in stack if not line.filename.startswith(_OURS)]
    )
