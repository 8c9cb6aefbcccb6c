"""Faults of the manager itself: exceptions in its loop, its files, threads and clock.

A part of the loop that raises is journalled, is a deviation until it works again, and
backs off alone. No bug of Poise ends a robot.
"""

from __future__ import annotations

import re
import threading
import time
import traceback
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from typing import NamedTuple, Protocol

from msgspec.structs import replace

from poise.clock import Clock, wall_time
from poise.errors import PoiseError, TakenOver, last_error
from poise.manage.agent_connections.statuses import Statuses
from poise.manage.journal import EntryKind, Journal
from poise.manage.observe.deviations import Deviation
from poise.threads import SHOWN_FOR, explained
from poise.units import counted
from poise.wire.records.status_records import ComponentStatus, ContainerStatus

_LEAST_JUMP = 1.0
"""A clock that jumps by less is not worth a word [s]."""
_MOST_SHOWN = 20
"""The most passing events that are shown; all are journalled."""


class Troubled(Protocol):
    """What may be in trouble."""

    @property
    def trouble(self) -> str:
        """A sentence; empty: all is well."""
        ...


class ManagerTroubles:
    """Looks at the manager itself. The robot goes on, and nothing moves for it.

    `wall`: the time [s], by the clock that people set;
    `now`: the time [s], by one that never jumps.
    """

    def __init__(
        self,
        journal: Journal,
        wall: Callable[[], float] = wall_time,
        now: Callable[[], float] = time.monotonic,
        others: Iterable[Troubled] = (),
    ) -> None:
        self._journal = journal
        self._wall = wall
        self._now = now
        self._offset = wall() - now()
        self._watched = (journal, *others)
        self._troubles: dict[int, Deviation] = {}
        self._shown: dict[str, tuple[float, Deviation]] = {}
        """What happened lately, by what it is about, and when; replaced as a whole."""
        self._lock = threading.Lock()

    def check(self) -> None:
        """Journal a jump of the clock; call it several times a second."""
        offset = self._wall() - self._now()
        jump, self._offset = offset - self._offset, offset
        if abs(jump) >= _LEAST_JUMP:
            way = "forward" if jump > 0 else "back"
            what = (
                f"the clock of the manager's computer jumped {way} by {abs(jump):.0f} "
                "s: times before that are off; nothing else depends on it"
            )
            self._journal.note("wrong", what, seconds=jump)
            self._show("clock", what)
        for number, part in enumerate(self._watched):
            self._note(number, part.trouble)

    def note_failure(self, thread: str, error: BaseException) -> None:
        """Journal what `poise.threads.hear_failures` reports of a thread."""
        what = (
            f"the thread '{thread}' of the manager's process failed "
            f"({type(error).__name__}: {error}); all else goes on"
        )
        text = "".join(traceback.format_exception(error))
        self._journal.note("failed", what, traceback=text)
        self._show(f"thread {thread}", what)

    def deviations(self) -> list[Deviation]:
        """Return what is wrong now, or happened within `SHOWN_FOR`; from any thread."""
        recent = self._recent().values()
        return [*self._troubles.copy().values(), *(shown for _, shown in recent)]

    def _show(self, about: str, what: str) -> None:
        new = self._now(), self._deviation(what)
        with self._lock:
            shown = self._recent()
            shown.pop(about, None)  # the last comes last
            self._shown = dict([*shown.items(), (about, new)][-_MOST_SHOWN:])

    def _recent(self) -> dict[str, tuple[float, Deviation]]:
        since = self._now() - SHOWN_FOR
        return {name: shown for name, shown in self._shown.items() if shown[0] >= since}

    def _note(self, number: int, trouble: str) -> None:
        """Journal that a trouble begins, and ends, but not each of its counts."""
        before = self._troubles.get(number)
        if not trouble:
            if before is not None:
                del self._troubles[number]
                self._journal.note("right", before.end())
            return
        if before is None or _but_counts(before.what) != _but_counts(trouble):
            self._journal.note("wrong", trouble)
            before = self._deviation(trouble)
        self._troubles[number] = replace(before, what=trouble)

    def _deviation(self, what: str) -> Deviation:
        return Deviation(what=what, computer="", since=self._wall())


def _but_counts(sentence: str) -> str:
    return re.sub(r"\d+ (\w+?)s?\b", r"\1", sentence)


QUIET = 10.0
"""Errors of one kind are over when none came for so long [s]."""
_MOST = 10
"""So many incarnations of a component are told apart; two are there in a move."""
_Counts = Mapping[str, tuple[int, Deviation]]
"""Kind of error -> how often, and the first one."""


class CodeErrors:
    """Tells what goes wrong now from what did before: errors, and messages refused.

    A component that failed is a deviation, and not told of here.
    """

    def __init__(self, note: Callable[[EntryKind, str], object]) -> None:
        self._note = note
        self._counts: dict[str, dict[Hashable, _Counts]] = {}
        """Component or connector -> incarnation -> what was counted."""
        self._coming: dict[tuple[str, str], tuple[Deviation, int, float]] = {}
        """What goes wrong now, how often it did so, and when it did last."""

    def record(
        self, statuses: Statuses, now: float, *, are_known: bool = False
    ) -> None:
        """Note what is new in `statuses`, and what came no more until `now` [s].

        `are_known`: an earlier manager has told of them.
        """
        for computer, status in statuses.items():
            for container in status.containers:
                for component in container.components:
                    name = component.name
                    if not component.error_counts and name not in self._counts:
                        continue
                    # another boot may give the same number
                    stay = container.pid, component.start, component.epoch
                    raised = _raised(component, computer)
                    is_told = are_known or component.state == "failed"
                    self._note_news(name, stay, raised, now, is_told=is_told)
                for name, count in refused(container):
                    error = Deviation(
                        what=f"connector '{name}' refused messages on '{computer}': "
                        "not of the port's type; `poise log` says more",
                        computer=computer,
                        since=wall_time(),
                    )
                    counts = {"": (count, error)}
                    self._note_news(name, container.pid, counts, now, is_told=are_known)
        for key, (error, count, last) in list(self._coming.items()):
            if now - last >= QUIET:
                del self._coming[key]
                self._note("right", f"{error.end()} ({counted(count, 'time')})")

    def deviations(self) -> tuple[Deviation, ...]:
        """Return what goes wrong now."""
        return tuple(error for error, _, _ in self._coming.copy().values())

    def _note_news(
        self,
        name: str,
        stay: Hashable,
        counts: _Counts,
        now: float,
        *,
        is_told: bool = False,
    ) -> None:
        """Note what is new of an incarnation; `is_told`: somebody else tells of it."""
        known = self._counts.setdefault(name, {})
        before = known.pop(stay, {})
        for kind, (count, error) in () if is_told else counts.items():
            earlier = before[kind][0] if kind in before else 0
            # an end of a connector may begin again in the same process
            new = count - earlier if count >= earlier else count
            if new and (name, kind) not in self._coming:
                self._note("wrong", error.what)
            if new:
                first, so_far, _ = self._coming.get((name, kind), (error, 0, now))
                self._coming[name, kind] = first, so_far + new, now
        known[stay] = counts
        if len(known) > _MOST:
            del known[next(iter(known))]


def _raised(component: ComponentStatus, computer: str) -> _Counts:
    counts: dict[str, tuple[int, Deviation]] = {}
    name = component.name
    for error in component.error_counts:
        text = last_error(error.text)
        # what Poise itself refuses, such as a state, comes without a traceback
        raised = " raised" if "\n" in error.text else ":"
        handler = f"'{error.where}' of component '{name}' on '{computer}'{raised}"
        said = Deviation(
            what=f"{handler} {text}; `poise log {name}` says more",
            computer=computer,
            since=error.first,
        )
        kind = f"{error.where} {text.partition(':')[0]}"
        count, said = counts.get(kind, (0, said))
        counts[kind] = count + error.count, said
    return counts


def refused(container: ContainerStatus) -> Iterator[tuple[str, int]]:
    """Yield connectors whose targets refused messages, and how many."""
    for end in container.connectors:
        if end.refused:
            yield end.name, end.refused


FIRST_PAUSE = 1.0
"""A part that raised is left out for this time [s]; twice as long each time."""
LONGEST_PAUSE = 60.0


class _Failure(NamedTuple):
    """A part that raised when it was run last."""

    deviation: Deviation
    pause: float
    again_at: float


class ManagerParts:
    """Runs the parts of the manager's loop, on its thread; no bug in one ends it."""

    def __init__(
        self,
        journal: Journal,
        clock: Clock,
        on_bug: Callable[[str], object] = lambda _: None,
        is_ending: Callable[[], bool] = lambda: False,
    ) -> None:
        self._journal = journal
        self._clock = clock
        self._on_bug = on_bug
        self._is_ending = is_ending
        self._failures: dict[str, _Failure] = {}

    def run(
        self, part: str, work: Callable[[], object], *, changes: bool = False
    ) -> object:
        """Run a part, unless it backs off; return what it returns, or None."""
        if self._failures and self.backs_off(part):
            return None
        try:
            result = work()
        except TakenOver:
            raise
        except Exception as error:  # noqa: BLE001, no bug of Poise ends a robot
            if not (isinstance(error, PoiseError) and self._is_ending()):
                self._note(part, error, changes=changes)
            return None
        if self._failures and self._failures.pop(part, None) is not None:
            self._journal.note("right", f"the manager can {part} again")
        return result

    def backs_off(self, part: str) -> bool:
        """Return whether a part raised, and is not tried again yet."""
        failure = self._failures.get(part)
        return failure is not None and self._clock.now() < failure.again_at

    def deviations(self) -> list[Deviation]:
        """Return what does not work now; from any thread."""
        return [failure.deviation for failure in list(self._failures.values())]

    def _note(self, part: str, error: Exception, *, changes: bool) -> None:
        before = self._failures.get(part)
        pause = min(2 * before.pause, LONGEST_PAUSE) if before else FIRST_PAUSE
        error = explained(error)
        is_bug = not isinstance(error, PoiseError)
        said = f"{type(error).__name__}: {error}" if is_bug else str(error)
        why = "a bug in Poise, please report it" if is_bug else "it is tried again"
        what = f"the manager cannot {part} ({said}): {why}; all else goes on"
        since = before.deviation.since if before else wall_time()
        deviation = Deviation(what=what, computer="", since=since)
        self._failures[part] = _Failure(deviation, pause, self._clock.now() + pause)
        text = f"{what}; the next try is in {pause:g} s"
        self._journal.note("failed", text, traceback=traceback.format_exc())
        if is_bug and changes:
            self._on_bug(what)
