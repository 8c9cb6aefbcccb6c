"""Replays what real containers did in a migration against the model."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from poise.manage.migration.migration_report import MigrationReport
from poise.wire.records.migration_records import STEPS, StepTaken
from tests.model_of_moves.protocol import Protocol, initial, prepare, resuming, transfer
from tests.model_of_moves.world import Bounds, State

_WHO = re.compile(r"(.+)/(\d+)")
_RELEASES = {
    "release to targets": "release to new",
    "release to sources": "release to old",
}


class Recorded(NamedTuple):
    """A step of a real migration, in the model's words."""

    name: str
    began: float
    ended: float


def replay(report: MigrationReport, component: str, *, kills: int = 0) -> str:
    """Return why the model cannot do what a real migration of one component did.

    Empty: there is an order of the model's steps in which each recorded step comes
    after those that had ended when it began, and that has the same outcome.
    """
    bounds = Bounds(
        messages=0, prepares=True, gives_up=0 if report.committed else 1, kills=kills
    )
    recorded = list(_in_words(report.steps, component))
    search = _Search(bounds, recorded, committed=report.committed)
    for step in recorded:
        if step.name not in search.known:
            return f"the model does not know the step '{step.name}'"
    furthest = search.run()
    if furthest is None:
        return ""
    left = [s.name for k, s in enumerate(recorded) if not furthest >> k & 1]
    return f"the model does not allow any of {left} next, or not this end"


class _Search:
    """Looks for a way through the model that takes all recorded steps."""

    def __init__(
        self, bounds: Bounds, recorded: Sequence[Recorded], *, committed: bool
    ) -> None:
        self._bounds = bounds
        self._successors = Protocol(bounds).successors
        self.known = set(_known(bounds))
        self._recorded = recorded
        self._committed = committed
        self._before = [
            sum(1 << k for k, o in enumerate(recorded) if o.ended < step.began)
            for step in recorded
        ]

    def run(self) -> int | None:
        """Return None when there is one; else the most steps that could be taken."""
        start = initial(self._bounds), 0
        seen, waiting, furthest = {start}, [start], 0
        all_taken = (1 << len(self._recorded)) - 1
        spec = "new" if self._committed else "old"
        while waiting:
            state, taken = waiting.pop()
            furthest = max(furthest, taken, key=int.bit_count)
            if taken == all_taken and state.spec == spec:
                return None
            for following in self._following(state, taken):
                if following not in seen:
                    seen.add(following)
                    waiting.append(following)
        return furthest

    def _following(self, state: State, taken: int) -> Iterator[tuple[State, int]]:
        for name, after in self._successors(state):
            if name not in self.known or _num_failed(after) > _num_failed(state):
                yield after, taken
                continue
            for k, step in enumerate(self._recorded):
                is_next = not taken >> k & 1 and self._before[k] & ~taken == 0
                if step.name == name and is_next:
                    yield after, taken | 1 << k
            # a container that ended or was given up did not say what it had done
            if not self._committed or state.round == "resume":
                yield after, taken


def _num_failed(state: State) -> int:
    return sum(order.outcome == "failed" for order in state.orders)


def _known(bounds: Bounds) -> Iterator[str]:
    rounds = [prepare(bounds), *transfer(bounds, "")]
    rounds += [resuming("old", bounds), resuming("new", bounds)]
    for orders in rounds:
        for order in orders:
            yield from (f"{step} at {order.container}" for step in order.steps)


def _in_words(steps: Sequence[StepTaken], component: str) -> Iterator[Recorded]:
    """Yield the steps; the model's sink stands for all who get something from it."""
    # a source that has not answered says nothing
    targets = {s.who for s in steps if s.step in STEPS and STEPS[s.step][0] == "target"}
    at_sink: list[StepTaken] = []
    for step in steps:
        name: str = step.step
        who = _WHO.fullmatch(step.who)
        if who is None:
            where = "source"
            name = _RELEASES.get(name, name)
        elif who[1] == component:
            where = "new 0" if step.who in targets else "old 0"
        else:
            at_sink.append(step)
            continue
        yield Recorded(f"{name} at {where}", step.began, step.ended)
    if at_sink:
        began, ended = min(s.began for s in at_sink), max(s.ended for s in at_sink)
        yield Recorded(f"{at_sink[0].step} at sink", began, ended)
