"""Puts new incarnations in the place of old ones while the robot works, or does not.

::

    prepare    the new ones are configured, their connectors are joined, and they fetch
               a large state; the old ones still serve
    hand over  what others send to the old ones is held, and they come to rest; what was
               under way to them and from them arrives; the new ones take state, waiting
               messages and timers, and are activated; they stay at rest: from here on
               the exchange is kept
    open       they go to work; what was held, and every caller that waits, goes to them
    remove     the old ones end

Until the exchange is kept, any failure leads back: the old ones go on with all that
waits for them, and the new ones are removed. Old and new are never at work together,
whatever answer gets lost, because the old ones never go on after that and the new ones
never go to work before. Why nothing is lost, doubled or reordered, and the model that
checks it: docs/design/moves.md.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator, Mapping, Sequence

from msgspec import Struct

from poise.errors import RunError
from poise.manage.deployment import Incarnation
from poise.manage.migration.plan import MigrationPlan, Rounds, Where
from poise.manage.run import Run, components_of
from poise.priority import first
from poise.wire.records.migration import Done, Order, Step

PREPARE_LIMIT = 30.0
"""The new ones are configured, and a large state is there, within this time [s]."""
GATE_LIMIT = 1.4
"""The exchange is kept within this time after the gate shut [s], or it leads back."""
OPEN_LIMIT = 0.4
"""Opening takes no longer than this [s], so that a gate is shut for 2 s at most: these
two, and `MARGIN` for each answer that does not come."""
LINGER = 0.1
"""The old ones are there for so long after the gate opened [s]: a caller that chose its
way before, and got no CPU since, is told there that they moved."""
REMOVE_LIMIT = 2.0
"""What is not wanted any more is gone after this time [s]; else the journal says so."""

# a manager that is started later has higher ones
_numbers = itertools.count(time.time_ns())


class MigrationReport(Struct, frozen=True, kw_only=True):
    """How an exchange went.

    Parameters
    ----------
    committed
        Whether the new ones run now; else the old ones do, as before.
    reason
        Why not.
    prepared
        How long it took before the gate shut [s].
    gate_shut
        How long the gate was shut [s].
    seconds
        How long each part took [s]: what the manager saw (``prepare``, ``hand over``,
        ``open``), and the longest step of each kind in a container (``Rest``, ...).
    """

    committed: bool = False
    reason: str = ""
    prepared: float = 0.0
    gate_shut: float = 0.0
    seconds: Mapping[str, float] = {}


class MigrationCoordinator:
    """One change of what runs. Use it once."""

    def __init__(self, run: Run, change: MigrationPlan) -> None:
        self._run = run
        self._change = change
        gone = {each.component for each in change.olds}
        others = {n: each for n, each in run.placed.items() if n not in gone}
        self._others = others
        self._rounds = Rounds(
            run.layout, change, others, run.calls(), next(_numbers), run.gateways()
        )
        self._seconds: dict[str, float] = {}
        self._shut_at = 0.0
        self._opened_at = 0.0

    def run(self) -> MigrationReport:
        """Change, or lead back; never raises for what goes wrong on the way."""
        started = time.monotonic()
        try:
            self._prepare()
        except RunError as error:
            self._remove(self._change.news)
            return self._outcome(started, str(error))
        self._note("prepare", started)
        with first():
            reason = self._exchange()
        if not reason:
            time.sleep(LINGER)
        self._remove(self._change.news if reason else self._change.olds)
        return self._outcome(started, reason)

    def _exchange(self) -> str:
        """Shut the gate and open it to one side; return why it led back, if it did."""
        self._shut_at = time.monotonic()
        reason = ""
        try:
            for steps in self._rounds.hand_over():
                self._take(steps, self._left())
        except RunError as error:
            reason = str(error)
        self._note("hand over", self._shut_at)
        if reason:
            self._open(self._rounds.back())
        else:
            self._keep()
        return reason

    def _outcome(self, started: float, reason: str = "") -> MigrationReport:
        shut = self._shut_at or time.monotonic()
        return MigrationReport(
            committed=not reason,
            reason=reason,
            prepared=shut - started,
            gate_shut=self._opened_at - self._shut_at if self._shut_at else 0.0,
            seconds=self._seconds,
        )

    def _note(self, part: str, since: float) -> float:
        now = time.monotonic()
        self._seconds[part] = now - since
        return now

    def _prepare(self) -> None:
        run, change = self._run, self._change
        staying = [old.with_goal("stay") for old in change.olds]
        run.tell([*self._others.values(), *staying, *change.news], run.computers())
        run.wait(change.news, PREPARE_LIMIT, self._raise_on_failed)
        for steps in self._rounds.prepare():
            self._take(steps, PREPARE_LIMIT)

    def _keep(self) -> None:
        """Go on with the new incarnations; nothing leads back any more."""
        placed = self._run.placed
        for old in self._change.olds:
            del placed[old.component]
        for new in self._change.news:
            placed[new.component] = new.with_goal("active")
        self._open(self._rounds.keep())

    def _open(self, steps: Sequence[Where]) -> None:
        """Let the chosen ones go to work, and all that waits go to them.

        A container that is not reached is told by the deployment that follows: it then
        knows of one way only, and what it held goes there.
        """
        began = time.monotonic()
        for outcome in self._run.agents.order(self._orders(steps, OPEN_LIMIT)):
            if not isinstance(outcome, Done):
                self._note_failure(outcome.reason)
        self._opened_at = self._note("open", began)

    def _remove(self, gone: Sequence[Incarnation]) -> None:
        """Let only what is placed run, and wait until those that go have ended."""
        run = self._run

        def have_ended() -> bool:
            return all(map(run.has_ended, gone))

        try:
            run.tell(run.placed.values(), run.computers())
            if not run.agents.wait_news(have_ended, REMOVE_LIMIT):
                hanging = [e.component for e in gone if not run.has_ended(e)]
                self._note_failure(f"'{', '.join(hanging)}' does not end")
        except RunError as error:
            self._note_failure(f"telling what should run: {error}")

    def _note_failure(self, reason: str) -> None:
        self._run.journal.note("failed", f"exchange of {self._change.what}: {reason}")

    def _raise_on_failed(self) -> bool:
        run = self._run
        run.raise_on_cancel()
        run.raise_on_lost()
        news = {(new.component, new.epoch): new for new in self._change.news}
        olds = {(old.component, old.epoch): old for old in self._change.olds}
        for component in components_of(run.current()):
            key = component.name, component.epoch
            if key in news and component.state == "failed":
                raise RunError(
                    f"component '{component.name}' cannot be configured on "
                    f"'{news[key].computer}':\n{component.error}"
                )
            if key in olds and component.state != "active":
                raise RunError(
                    f"component '{component.name}' ended on '{olds[key].computer}' "
                    "before it could hand over"
                )
        return False

    def _left(self) -> float:
        left = self._shut_at + GATE_LIMIT - time.monotonic()
        if left <= 0:
            raise RunError(f"the gate was shut for {GATE_LIMIT:g} s")
        return left

    def _take(self, steps: Sequence[Where], limit: float) -> None:
        """Take steps, those of different containers at once.

        Raises
        ------
        RunError
            One failed; others may still be under way.
        """
        for outcome in self._run.agents.order(self._orders(steps, limit)):
            if not isinstance(outcome, Done):
                raise RunError(outcome.reason)
            for kind, seconds in outcome.seconds.items():
                self._seconds[kind] = max(self._seconds.get(kind, 0.0), seconds)

    def _orders(
        self, steps: Sequence[Where], limit: float
    ) -> Iterator[tuple[str, Order]]:
        by_container: dict[tuple[str, str], list[Step]] = {}
        for where, step in steps:
            container = self._run.layout.container_of(where.component)
            by_container.setdefault((where.computer, container), []).append(step)
        for (computer, container), mine in by_container.items():
            yield computer, Order(next(_numbers), container, tuple(mine), limit)
