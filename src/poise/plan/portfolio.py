"""Which solver when: greedy at once, a proof where that is quick, else search."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, log2
from time import perf_counter, thread_time
from typing import NamedTuple, cast

from poise.errors import UsageError
from poise.plan._core import Core
from poise.plan.problem.arrays import Placed
from poise.plan.result import Result
from poise.plan.result_records import Answer, Ask, Stopped
from poise.plan.snapshot import Snapshot
from poise.plan.why.conflict import is_hopeless

BUSY = 4.0
"""On a busy machine a budget lasts this many times as long at most; `Stop` of the core
(`plan/core/problem/stop.h`) has the same number."""


class Budget:
    """What this thread may spend from now on [s of a CPU]."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._began, self._cpu = perf_counter(), thread_time()

    def left(self) -> float:
        """Return what is left [s]; below 0 when it is over."""
        waited = (perf_counter() - self._began) / BUSY
        return self._seconds - max(thread_time() - self._cpu, waited)


METHODS = ("auto", "greedy", "exact", "search")

UNLIMITED = 1 << 62
"""A number of steps that no solver reaches."""
GLANCE = 0.1
"""Which part of the effort a first proof may take: often it is enough."""
MOST_PLACEMENTS = 100
"""Up to 2 to the power of this many placements (50 components on 4 computers) a second
proof has a chance. On two computers it is the frontier that counts."""
LOOK_AROUND = 0.15
"""Which part of the effort goes into a first search, so that a second proof starts
well."""
PROOF = 0.5
"""Which part of the effort may go into a second proof."""


class Effort(NamedTuple):
    """How long to decide: `seconds` of CPU time, or `steps` to be reproducible.

    `stop` may say that it is enough.
    """

    seconds: float
    steps: int | None
    seed: int = 0
    stop: Ask | None = None

    def share(self, part: float) -> Effort:
        """Return a part, in (0, 1], of the effort."""
        steps = None if self.steps is None else int(self.steps * part)
        return Effort(self.seconds * part, steps, self.seed, self.stop)

    def is_none(self) -> bool:
        """Whether there is no time for anything but the greedy."""
        return self.seconds <= 0 if self.steps is None else self.steps == 0

    def exact(self, core: Core, known: Placed) -> Answer:
        """Spend it on a proof."""
        if self.steps is not None:
            return Answer(*core.exact(known, inf, self.steps, self.stop))
        return Answer(*core.exact(known, self.seconds, UNLIMITED, self.stop))

    def search(self, core: Core, known: Placed) -> Answer:
        """Spend it on search."""
        seconds, steps = inf, self.steps
        if steps is None:
            seconds, steps = self.seconds, UNLIMITED
        return Answer(*core.search(known, seconds, steps, self.seed, self.stop))


def decide(snapshot: Snapshot, method: str, effort: Effort) -> Result:
    """Decide a problem in which every component is needed."""
    core = snapshot.core
    known, name = _start(snapshot, method)
    if method == "greedy" or (effort.is_none() and method == "auto"):
        return Result.of(snapshot, known, name)
    if method == "exact":
        if not core.provable:
            raise UsageError(
                f"{snapshot.size} components on {len(snapshot.problem.computers)} "
                "computers are too many for 'exact' (at most 1024 on 64); take 'search'"
            )
        answer, finder = effort.exact(core, known), "exact"
    elif method == "search":
        answer, finder = effort.search(core, known), "search"
    else:
        answer, finder = _auto(snapshot, known, effort)
    if answer.proven or answer.placed != known:
        name = finder
    return _described(snapshot, name, answer)


def _described(snapshot: Snapshot, method: str, answer: Answer) -> Result:
    proven, stopped_by = answer.proven, answer.stopped_by
    is_none = not answer.placed and snapshot.size > 0
    if is_none and (proven or is_hopeless(snapshot.arrays)):
        proven, stopped_by = True, "infeasible"
    return Result.of(
        snapshot,
        answer.placed,
        method,
        proven=proven,
        stopped_by=cast("Stopped", stopped_by),
        bound=max(answer.bound, snapshot.core.bound()),
    )


def _start(snapshot: Snapshot, method: str) -> tuple[Placed, str]:
    """Return the placement to start from: as it is now, or the greedy's, or none."""
    core = snapshot.core
    greedy, complete = core.greedy()
    placed: Placed = greedy if complete else []
    present: Placed = [] if method == "greedy" else snapshot.present
    if not (present and core.feasible(present)):
        return placed, "greedy"
    if placed and sum(core.terms(placed)) < sum(core.terms(present)):
        return placed, "greedy"
    return present, "present"


def _may_be_proven(snapshot: Snapshot) -> bool:
    n, m = snapshot.size, len(snapshot.problem.computers)
    return m == 2 or n * log2(m) <= MOST_PLACEMENTS  # noqa: PLR2004 - a tree of its own


def _auto(snapshot: Snapshot, known: Placed, effort: Effort) -> tuple[Answer, str]:
    """Try to prove at once; search a little, try to prove again, and search on."""
    core = snapshot.core
    if not core.provable:
        return effort.search(core, known), "search"
    budget = Budget(effort.seconds)
    before, used = effort.share(GLANCE).exact(core, known), GLANCE
    if before.proven or before.stopped_by == "interrupted":
        return before, "exact"
    # A search in two parts finds less than one: only for a proof it is worth it.
    if _may_be_proven(snapshot):
        first = effort.share(LOOK_AROUND).search(core, before.placed)
        if first.stopped_by == "interrupted":
            return first, "search"
        before = effort.share(PROOF).exact(core, first.placed)
        used += LOOK_AROUND + PROOF
        if before.proven or before.stopped_by == "interrupted":
            return before, "exact"
    left = max(0.0, budget.left())
    rest = Effort(left, effort.share(1 - used).steps, effort.seed + 1, effort.stop)
    last = rest.search(core, before.placed)
    return last._replace(bound=max(last.bound, before.bound)), "search"


Decide = Callable[[frozenset[str], float], Result]
"""Decides some components with a share, in (0, 1], of the effort."""
