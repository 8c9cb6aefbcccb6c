"""The best that is known of a problem: what long runs of all methods found.

They take over a minute a problem. So they are kept, in a file for each problem, and a
benchmark that was ended goes on where it was. Placements are kept, not their F, which
is computed anew: it is that of the code that is measured.
"""

from __future__ import annotations

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from time import process_time

import msgspec
from msgspec import Struct

from poise import plan
from poise.errors import UsageError
from poise.plan import cpsat
from poise.plan.engine import Answer, Ask, Engine
from poise.plan.tables import tabulate

SEARCH = 2_000_000
"""How many steps the search may take, under a second."""
CPSAT, PROOF = 60.0, 10.0
"""How long CP-SAT, and our own proof, may compute on one core [s]."""
LONGEST = 20 * CPSAT
"""How long that may take on a busy machine [s]."""


class Found(Struct, frozen=True):
    """What a method found; `placed` is empty when it found nothing.

    `seconds` is CPU time; `proven` says whether the method proved that it is the best,
    or that there is none.
    """

    placed: list[int]
    proven: bool
    seconds: float


class Reference(Struct, frozen=True):
    """The long runs of one problem; `cpsat` is None where OR-Tools is missing.

    `ours` is what the search found, or the optimum that our own proof ends with.
    """

    ours: Found
    cpsat: Found | None


def reference(problem: plan.Problem, folder: Path) -> Reference:
    """Return the long runs of `problem`: those kept in `folder`, or new ones."""
    path = folder / f"{sha256(msgspec.json.encode(problem)).hexdigest()[:32]}.json"
    if path.exists():
        return msgspec.json.decode(path.read_bytes(), type=Reference)
    tables = tabulate(problem)
    engine = Engine(tables)
    greedy = engine.greedy()
    known = [] if -1 in greedy else greedy

    start = process_time()
    placed = engine.search(known, steps=SEARCH, seed=2).placed
    ours = Found(placed, proven=False, seconds=process_time() - start)
    proof = _run(PROOF, lambda ask: engine.exact(placed, LONGEST, stop=ask))
    if proof.proven:
        ours = proof
    found = Reference(
        ours,
        _certified(lambda stop: cpsat.solve(tables, LONGEST, 0, workers=1, stop=stop)),
    )
    folder.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_bytes(msgspec.json.encode(found))
    part.rename(path)
    return found


Run = Callable[[Ask], Answer]


def _certified(run: Run) -> Found | None:
    try:
        return _run(CPSAT, run)
    except UsageError:
        return None


def _run(seconds: float, run: Run) -> Found:
    start = process_time()
    answer = run(lambda: process_time() - start >= seconds)
    return Found(answer.placed, answer.proven, process_time() - start)
