"""Moves one component while the robot works, or leaves it where it was.

::

    prepare   a second incarnation is configured at the target, its connectors are
              joined, and it fetches a large state; the first one still serves
    gate      what others send to the component is held, and it comes to rest
    flush     what was under way to it and from it arrives
    hand over the second incarnation takes state, waiting messages and timers, and is
              activated; it stays at rest: from here on the move is kept
    open      it goes to work; what was held, and every caller that waits, goes to it
    remove    the first incarnation ends

Until the move is kept, any failure leads back: the first incarnation goes on with all
that waits for it, and the second is removed. At most one of them is at work, whatever
answer gets lost, because the first never goes on after that and the second never goes
to work before. Why nothing is lost, doubled or reordered, and the model that checks it:
docs/design/moves.md.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator, Mapping, Sequence

import msgspec
from msgspec import Struct

from poise.errors import RunError, UsageError
from poise.manage.deployment import Incarnation, name_of
from poise.manage.run import Run, components_of
from poise.model.check.hosts import allowed_hosts
from poise.model.robot import Component, Connector
from poise.wire.messages import (
    Activate,
    Done,
    Flush,
    Hold,
    Offer,
    Open,
    Order,
    Precopy,
    Release,
    Rest,
    Retire,
    Step,
    Take,
)

PREPARE_LIMIT = 30.0
"""The second is configured, and a large state is there, within this time [s]."""
GATE_LIMIT = 1.4
"""The move is kept within this time after the gate shut [s], or it leads back."""
OPEN_LIMIT = 0.4
"""Opening takes no longer than this [s], so that a gate is shut for 2 s at most: these
two, and `MARGIN` for each answer that does not come."""
REMOVE_LIMIT = 2.0
"""What is not wanted any more is gone after this time [s]; else the journal says so."""

# a manager that is started later has higher ones
_numbers = itertools.count(time.time_ns())

Where = tuple[Incarnation, Step]
"""A step, and an incarnation whose container takes it."""


class MoveReport(Struct, frozen=True, kw_only=True):
    """How a move went.

    Parameters
    ----------
    committed
        Whether the component runs at the target now; else it is where it was.
    reason
        Why not.
    prepared
        How long it took before the gate shut [s].
    gate_shut
        How long the gate was shut [s].
    """

    component: str
    source: str
    target: str
    committed: bool
    reason: str = ""
    prepared: float = 0.0
    gate_shut: float = 0.0


class Move:
    """One move of one component. Use it once."""

    def __init__(self, run: Run, old: Incarnation, new: Incarnation) -> None:
        self._run = run
        self._old = old
        self._new = new
        self._name = old.component
        others = run.placed.keys() - {self._name}
        self._into = run.layout.into(self._name, others)
        self._out_of = run.layout.out_of(self._name, others)
        self._shut_at = 0.0
        self._opened_at = 0.0

    def run(self) -> MoveReport:
        """Move, or lead back; never raises for what goes wrong on the way."""
        started = time.monotonic()
        try:
            self._prepare()
        except RunError as error:
            self._remove(self._new)
            return self._report(started, str(error))
        self._shut_at = time.monotonic()
        try:
            self._hand_over()
        except RunError as error:
            self._lead_back()
            return self._report(started, str(error))
        self._keep()
        return self._report(started)

    def _report(self, started: float, reason: str = "") -> MoveReport:
        shut = self._shut_at or time.monotonic()
        report = MoveReport(
            component=self._name,
            source=self._old.computer,
            target=self._new.computer,
            committed=not reason,
            reason=reason,
            prepared=shut - started,
            gate_shut=self._gate_shut() if self._shut_at else 0.0,
        )
        kind = "failed" if reason else "done"
        self._run.journal.note(kind, _sentence(report), move=report)
        return report

    def _prepare(self) -> None:
        run = self._run
        others = [each for each in run.placed.values() if each != self._old]
        both = [*others, self._old.with_goal("stay"), self._new]
        run.tell(both, run.computers())
        run.wait([self._new], PREPARE_LIMIT, self._raise_on_failed)
        name, old, new = self._name, self._old.epoch, self._new.epoch
        self._take([(self._old, Offer(name, old, new))], PREPARE_LIMIT)
        precopy = Precopy(name, new, old, PREPARE_LIMIT)
        self._take([(self._new, precopy)], PREPARE_LIMIT)

    def _hand_over(self) -> None:
        name, old, new = self._name, self._old.epoch, self._new.epoch
        marks = self._shut()
        self._flush(marks)
        limit = self._left()
        take_over = Take(name, new, old, limit), Activate(name, new, limit)
        self._take([(self._new, step) for step in take_over], limit)

    def _shut(self) -> dict[str, int]:
        """Hold what goes to the component and let it come to rest.

        Returns
        -------
        The marks behind all that went to it and from it, by connector.
        """
        limit, mark = self._left(), next(_numbers)
        holds: list[Where] = [
            (source, Hold(tuple(map(name_of, connectors)), mark))
            for source, connectors in self._by_source().items()
        ]
        rest = Rest(self._name, self._old.epoch, mark, limit)
        return self._take([*holds, (self._old, rest)], limit)

    def _flush(self, marks: Mapping[str, int]) -> None:
        """Wait until all has arrived that went to the component, and from it."""
        limit = self._left()
        steps: list[Where] = []
        for connector in (*self._into, *self._out_of):
            name = name_of(connector)
            if name in marks:
                target = self._run.placed[connector.between[1].component]
                received = {name: marks[name]}
                step = Flush(target.component, target.epoch, received, limit)
                steps.append((target, step))
        self._take(steps, limit)

    def _keep(self) -> None:
        """Go on with the second incarnation; nothing leads back any more."""
        self._run.placed[self._name] = self._new.with_goal("active")
        self._open(self._new, (self._old, Retire(self._name, self._old.epoch)))
        self._remove(self._old)

    def _lead_back(self) -> None:
        """Go on with the first incarnation; the second was never at work."""
        self._open(self._old)
        self._remove(self._new)

    def _open(self, chosen: Incarnation, *more: Where) -> None:
        """Let the chosen one go to work, and all that waits go to it.

        A container that is not reached is told by the deployment that follows: it then
        knows of one way only, and what it held goes there.
        """
        step = Open(self._name, chosen.epoch)
        self._try([(chosen, step), *self._releases(chosen), *more], OPEN_LIMIT)
        self._opened_at = time.monotonic()

    def _remove(self, gone: Incarnation) -> None:
        """Let only what is placed run, and wait until `gone` has ended."""
        run = self._run
        try:
            run.tell(run.placed.values(), run.computers())
            if not run.fleet.wait_news(lambda: run.has_ended(gone), REMOVE_LIMIT):
                self._note_failure(f"'{gone.component}' ({gone.epoch}) does not end")
        except RunError as error:
            self._note_failure(f"telling what should run: {error}")

    def _note_failure(self, reason: str) -> None:
        self._run.journal.note("failed", f"move of '{self._name}': {reason}")

    def _raise_on_failed(self) -> bool:
        run = self._run
        run.raise_on_lost()
        for component in components_of(run.current()):
            if component.name != self._name:
                continue
            if component.epoch == self._new.epoch and component.state == "failed":
                raise RunError(
                    f"component '{self._name}' cannot be configured on "
                    f"'{self._new.computer}':\n{component.error}"
                )
            if component.epoch == self._old.epoch and component.state != "active":
                raise RunError(
                    f"component '{self._name}' ended on '{self._old.computer}' "
                    "before it was moved"
                )
        return False

    def _by_source(self) -> dict[Incarnation, list[Connector]]:
        """Return the connectors into the component, by one component per container."""
        found: dict[tuple[str, str], tuple[Incarnation, list[Connector]]] = {}
        for connector in self._into:
            source = self._run.placed[connector.between[0].component]
            container = self._run.layout.container_of(source.component)
            key = (source.computer, container)
            found.setdefault(key, (source, []))[1].append(connector)
        return dict(found.values())

    def _releases(self, towards: Incarnation) -> list[Where]:
        run = self._run
        return [
            (
                source,
                Release(
                    tuple(
                        run.layout.joined(
                            connector,
                            run.placed[connector.between[0].component],
                            towards,
                        ).key
                        for connector in connectors
                    )
                ),
            )
            for source, connectors in self._by_source().items()
        ]

    def _left(self) -> float:
        left = self._shut_at + GATE_LIMIT - time.monotonic()
        if left <= 0:
            raise RunError(f"the gate was shut for {GATE_LIMIT:g} s")
        return left

    def _take(self, steps: Sequence[Where], limit: float) -> dict[str, int]:
        """Take steps, those of different containers at once; return their numbers.

        Raises
        ------
        RunError
            One failed.
        """
        numbers: dict[str, int] = {}
        for outcome in self._run.fleet.order(self._orders(steps, limit)):
            if not isinstance(outcome, Done):
                raise RunError(outcome.reason)
            numbers |= outcome.numbers
        return numbers

    def _try(self, steps: Sequence[Where], limit: float) -> None:
        for outcome in self._run.fleet.order(self._orders(steps, limit)):
            if not isinstance(outcome, Done):
                self._note_failure(outcome.reason)

    def _orders(
        self, steps: Sequence[Where], limit: float
    ) -> Iterator[tuple[str, Order]]:
        by_container: dict[tuple[str, str], list[Step]] = {}
        for where, step in steps:
            container = self._run.layout.container_of(where.component)
            by_container.setdefault((where.computer, container), []).append(step)
        for (computer, container), mine in by_container.items():
            yield computer, Order(next(_numbers), container, tuple(mine), limit)

    def _gate_shut(self) -> float:
        return self._opened_at - self._shut_at


def move(run: Run, component: str, computer: str) -> MoveReport:
    """Move a running component to a computer.

    Raises
    ------
    UsageError
        There is no such component or computer, or it may not run there.
    """
    old = _placed(run, component)
    _check_target(run, component, computer)
    if old.computer == computer:
        raise UsageError(f"component '{component}' runs on '{computer}' already")
    new = Incarnation(
        component=component,
        computer=computer,
        epoch=run.next_epoch(component),
        goal="inactive",
        implementation=old.implementation,
    )
    return Move(run, old, new).run()


def replace(
    run: Run, component: str, implementation: str, adapt: str = ""
) -> MoveReport:
    """Swap a running component's implementation for another with fitting ports.

    Parameters
    ----------
    implementation
        ``package.module:Class``.
    adapt
        ``package.module:function`` that turns the old state into the new one; empty:
        the new implementation restores the old one's state as it is.

    Raises
    ------
    UsageError
        There is no such component.
    """
    old = _placed(run, component)
    new = msgspec.structs.replace(
        old,
        epoch=run.next_epoch(component),
        goal="inactive",
        implementation=implementation,
        adapt=adapt,
    )
    return Move(run, old, new).run()


def _placed(run: Run, component: str) -> Incarnation:
    try:
        return run.placed[component]
    except KeyError:
        known = ", ".join(sorted(run.placed))
        raise UsageError(f"no component '{component}' runs ({known} do)") from None


def _check_target(run: Run, component: str, computer: str) -> None:
    known = [each.name for each in run.robot.computers]
    if computer not in known:
        raise UsageError(f"no computer '{computer}' (there are {', '.join(known)})")
    allowed = allowed_hosts(run.robot)[component]
    if computer not in allowed:
        raise UsageError(
            f"component '{component}' may not run on '{computer}', only on "
            f"{' or '.join(allowed) or 'none'}"
        )
    if _component(run, component).command:
        raise UsageError(f"component '{component}' is a command line: it has no state")
    if not _component(run, component).movable:
        raise UsageError(f"component '{component}' is not movable (robot file)")


def _component(run: Run, name: str) -> Component:
    return next(each for each in run.robot.components() if each.name == name)


def _sentence(report: MoveReport) -> str:
    way = f"component '{report.component}' from '{report.source}' to '{report.target}'"
    if report.committed:
        return f"moved {way}; gate shut for {report.gate_shut * 1e3:.1f} ms"
    return f"did not move {way}: {report.reason}"
