"""Which solver when: greedy at once, a proof where that is quick, else search."""

from __future__ import annotations

from collections.abc import Callable
from math import log2
from time import perf_counter
from typing import Literal, get_args

from msgspec import Struct

from poise.plan import cpsat
from poise.plan.describe import described
from poise.plan.engine import UNLIMITED, Answer, Ask, Engine
from poise.plan.greedy import order
from poise.plan.infeasible import dead_end
from poise.plan.problem import Problem
from poise.plan.result import Result
from poise.plan.tables import Placed, Tables, tabulate

Method = Literal["auto", "greedy", "exact", "search", "cpsat"]
METHODS: tuple[str, ...] = get_args(Method)

GLANCE = 5_000
"""How many nodes a first proof may open: on a small robot half a millisecond, and often
enough."""
GLANCE_SHARE = 0.1
"""Which part of the budget it may take: on large robots a node takes microseconds."""
MOST_PLACEMENTS = 100
"""Up to 2 to the power of this many placements (50 components on 4 computers) a second
proof has a chance. On two computers it is the frontier that counts."""
LOOK_AROUND = 0.15
"""Which part of the budget goes into a first search, so that a proof starts well."""
PROOF = 0.5
"""Which part of the budget may go into a proof."""


class Effort(Struct, frozen=True):
    """How long to decide: `seconds`, or a number of `steps` to be reproducible.

    `stop` may say that it is enough.
    """

    seconds: float
    steps: int | None
    seed: int
    stop: Ask | None = None

    def share(self, part: float) -> Effort:
        """Return a part, in (0, 1], of the effort."""
        steps = None if self.steps is None else int(self.steps * part)
        return Effort(self.seconds * part, steps, self.seed, self.stop)

    @property
    def most_steps(self) -> int:
        """The limit of steps; none without time to decide."""
        if self.steps is not None:
            return self.steps
        return UNLIMITED if self.seconds > 0 else 0

    def glance(self, engine: Engine, known: Placed) -> Answer:
        """Spend a little of it on a proof."""
        most = min(GLANCE, self.most_steps)
        if self.steps is not None or not most:
            return engine.exact(known, steps=most, stop=self.stop)
        seconds = self.seconds * GLANCE_SHARE
        return engine.exact(known, seconds, most, self.stop)

    def exact(self, engine: Engine, known: Placed) -> Answer:
        """Spend it on a proof."""
        if self.steps is not None:
            return engine.exact(known, steps=self.steps, stop=self.stop)
        return engine.exact(known, seconds=self.seconds, stop=self.stop)

    def search(self, engine: Engine, known: Placed) -> Answer:
        """Spend it on search."""
        if self.steps is not None:
            return engine.search(
                known, steps=self.steps, seed=self.seed, stop=self.stop
            )
        return engine.search(
            known, seconds=self.seconds, seed=self.seed, stop=self.stop
        )


def decide(problem: Problem, method: str, effort: Effort) -> Result:
    """Solve a checked problem in which every component is needed."""
    tables = tabulate(problem)
    if any(not computers for computers in tables.allowed.values()):
        return _unplaced(tables, method, Answer([], 0.0, True, "infeasible", 0))
    engine = Engine(tables)
    known, name = _start(engine, method)
    if method == "greedy":
        return _greedy(engine, known)
    if method == "cpsat":
        answer, name = _cpsat(engine, known, effort), "cpsat"
    else:
        answer, finder = _SOLVERS[method](engine, known, effort)
        if answer.proven or _better(engine, answer.placed, known):
            name = finder
    if not answer.placed and tables.n:
        return _unplaced(tables, method, answer)
    return described(
        tables,
        answer.placed,
        method=name,
        bound=max(answer.bound, engine.bound()),
        proven=answer.proven,
        stopped_by=answer.stopped_by,
    )


def _start(engine: Engine, method: str) -> tuple[Placed, str]:
    """Return the placement to start from: as it is now, or the greedy's, or none."""
    placed = engine.greedy()
    if method == "greedy":
        return placed, "greedy"
    if -1 in placed:
        placed = []
    present = _present(engine.tables)
    if (
        present
        and engine.feasible(present)
        and (not placed or engine.total(present) <= engine.total(placed))
    ):
        return present, "present"
    return placed, "greedy"


def _present(tables: Tables) -> Placed:
    """Return the present placement, or nothing when some component has none."""
    index = {h.name: i for i, h in enumerate(tables.problem.computers)}
    placed = [-1] * tables.n
    for i, component in enumerate(tables.problem.components):
        if component.present is None:
            return []
        computer, unit = index[component.present], tables.unit_of[i]
        if placed[unit] not in {-1, computer}:
            return []
        placed[unit] = computer
    return placed


def _better(engine: Engine, placed: Placed, known: Placed) -> bool:
    if not placed:
        return False
    return not known or engine.total(placed) < engine.total(known)


def _greedy(engine: Engine, placed: Placed) -> Result:
    tables = engine.tables
    if -1 in placed:
        reason = dead_end(tables, placed, order(tables))
        return _described_as_none(tables, "greedy", reason=reason)
    return described(tables, placed, method="greedy", bound=engine.bound())


def _exact(engine: Engine, known: Placed, effort: Effort) -> tuple[Answer, str]:
    engine.must_be_provable()
    return effort.exact(engine, known), "exact"


def _search(engine: Engine, known: Placed, effort: Effort) -> tuple[Answer, str]:
    return effort.search(engine, known), "search"


def _cpsat(engine: Engine, known: Placed, effort: Effort) -> Answer:
    answer = cpsat.solve(
        engine.tables, effort.seconds, effort.seed, known=known, stop=effort.stop
    )
    # Its bound is about the same placements, so it holds for a known one too.
    worse = known and not _better(engine, answer.placed, known)
    return answer._replace(placed=known) if worse else answer


def _may_be_proven(engine: Engine) -> bool:
    n, m = engine.tables.n, engine.tables.m
    return m == 2 or n * log2(m) <= MOST_PLACEMENTS  # noqa: PLR2004 - a tree of its own


def _auto(engine: Engine, known: Placed, effort: Effort) -> tuple[Answer, str]:
    """Try to prove at once; search a little, try to prove again, and search on."""
    if not engine.provable:
        return _search(engine, known, effort)
    start = perf_counter()
    before, used = effort.glance(engine, known), 0.0
    if before.proven or before.stopped_by == "interrupted":
        return before, "exact"
    # A search in two parts finds less than one: only for a proof it is worth it.
    if _may_be_proven(engine):
        first = effort.share(LOOK_AROUND).search(engine, before.placed)
        if first.stopped_by == "interrupted":
            return first, "search"
        before = effort.share(PROOF).exact(engine, first.placed)
        used = LOOK_AROUND + PROOF
        if before.proven or before.stopped_by == "interrupted":
            return before, "exact"
    left = max(0.0, effort.seconds - (perf_counter() - start))
    steps = effort.share(1 - used).steps
    rest = Effort(left, steps, effort.seed + 1, effort.stop)
    last = rest.search(engine, before.placed)
    return last._replace(bound=max(last.bound, before.bound)), "search"


_SOLVERS: dict[str, Callable[[Engine, Placed, Effort], tuple[Answer, str]]] = {
    "auto": _auto,
    "exact": _exact,
    "search": _search,
}


def _unplaced(tables: Tables, method: str, answer: Answer) -> Result:
    reason = "no placement was found in the time given; there may be one"
    if answer.proven:
        reason = "no placement keeps all limits"
    return _described_as_none(
        tables,
        method,
        reason=reason,
        proven=answer.proven,
        stopped_by="infeasible" if answer.proven else answer.stopped_by,
    )


def _described_as_none(
    tables: Tables, method: str, *, reason: str, **known: object
) -> Result:
    fields: dict[str, object] = {
        "placement": {},
        "feasible": False,
        "reason": reason,
        "method": method,
        "scale": tables.problem.objective.scale,
        "spread": tables.problem.objective.spread,
    }
    return Result(**(fields | known))  # type: ignore[arg-type]
