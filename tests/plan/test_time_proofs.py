"""What is proven under time limits is so: all else was tried, by CP-SAT for one."""

from __future__ import annotations

import itertools
import math
from random import Random

import pytest
from msgspec.structs import replace

from benchmarks.random_robots import random_robot
from poise import plan
from poise.model.robot import Link
from poise.plan import Hop, Problem, Run, TimeLimit
from poise.plan.phase_search import merged
from poise.plan.problem.arrays import arrays_of
from poise.plan.violations import violations
from tests.plan.native import Native
from tests.plan.reference import objective, time
from tests.plan.test_brute_force import least, problem, softened


def timed(random: Random, asked: Problem) -> Problem:
    """Return the problem with time limits, such as some random placement nearly keeps.

    Every third problem has soft limits of CPU, too.
    """
    slow = random.random() < 0.5
    asked = replace(
        asked,
        computers=tuple(
            replace(h, speed=random.choice([1.0, 2.0]) if slow else 1.0)
            for h in asked.computers
        ),
        links=tuple(
            Link(
                between=pair,
                latency=random.choice([0.0, 0.002, 0.01]),
                bandwidth=random.choice([1e6, 1e7, math.inf]),
            )
            for pair in itertools.combinations([h.name for h in asked.computers], 2)
            if random.random() < 0.8
        ),
    )
    if random.random() < 1 / 3:
        asked = softened(random, asked)
    limits = [_limit(random, asked, f"t{i}") for i in range(random.randint(1, 4))]
    arrays = arrays_of(replace(asked, time_limits=tuple(limits)))
    placed = [random.randrange(arrays.m) for _ in range(arrays.n)]
    return replace(
        asked,
        time_limits=tuple(
            replace(
                each,
                limit=max(0.001, time.takes(arrays, placed, each))
                * random.choice([0.7, 0.9, 1.0, 1.1, 1.5]),
            )
            for each in limits
        ),
    )


def _limit(random: Random, asked: Problem, name: str) -> TimeLimit:
    names = [c.name for c in asked.components]
    return TimeLimit(
        name=name,
        limit=1.0,
        fixed=random.choice([0.0, 0.005]),
        runs=tuple(
            Run(component=random.choice(names), seconds=random.choice([0.01, 0.04]))
            for _ in range(random.randint(0, 4))
        ),
        hops=tuple(
            Hop(
                between=(random.choice(names), random.choice(names)),
                seconds=random.choice([0.0, 0.001]),
                crossings=random.choice([1.0, 2.0]),
                size=random.choice([0.0, 1e4, 1e5]),
            )
            for _ in range(random.randint(0, 4))
        ),
        shared=random.random() < 0.5,
        price=random.choice([0.0, 0.0, 0.1, 1.0]),
    )


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.parametrize(
    "seeds", [range(start, start + 60) for start in range(0, 360, 60)]
)
def test_no_placement_is_better_in_time(seeds: range) -> None:
    """Of 360 problems, about half can hold."""
    for seed in seeds:
        random = Random(seed)
        asked = timed(random, problem(random, random.randint(3, 5), 2 + seed % 2))
        proven, found = (
            plan.solve(asked, steps=100_000, method=method, why=False)
            for method in ("exact", "search")
        )
        best = least(asked)
        assert proven.proven
        assert proven.feasible == found.feasible == (best < math.inf)
        assert Native(arrays_of(asked)).bound() <= best + 1e-9
        if proven.objective is None or found.objective is None:
            continue
        assert proven.objective.total == pytest.approx(best, abs=1e-9)
        assert found.objective.total == pytest.approx(best, abs=1e-9)
        assert found.bound is not None
        assert found.bound <= best + 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(
    "seeds", [range(start, start + 50) for start in range(0, 200, 50)]
)
def test_cpsat_proves_the_same_in_time(seeds: range) -> None:
    cpsat = pytest.importorskip("benchmarks.cpsat")
    for seed in seeds:
        random = Random(1000 + seed)
        asked = timed(random, problem(random, random.randint(5, 9), 2 + seed % 2))
        ours = plan.solve(asked, 60.0, why=False)
        theirs = cpsat.certificate(asked, 60.0)
        assert ours.proven
        assert theirs.proven
        assert ours.feasible == bool(theirs.placed)
        if ours.objective is None:
            continue
        assert theirs.objective >= ours.objective.total - 1e-9
        assert theirs.objective == pytest.approx(ours.objective.total, rel=2e-3)
        assert theirs.bound <= ours.objective.total + 1e-9


@pytest.mark.slow
def test_a_conflict_of_time_is_one_and_its_relaxation_is_enough() -> None:
    """Of these, every conflict that raises limits alone has them raised."""
    seen = 0
    for seed in range(60):
        random = Random(seed)
        asked = timed(random, problem(random, 4, 2))
        found = plan.solve(asked, steps=20_000).conflict
        if found is None or not any("time limit" in each for each in found.limits):
            continue
        part = plan.keep_components(asked, found.components)
        assert least(part) == math.inf
        raises = {more.on[0]: more.amount for more in found.more}
        if found.price is None or {more.resource for more in found.more} != {"time"}:
            continue
        raised = (
            replace(each, limit=each.limit + raises.get(each.name, 0.0))
            for each in asked.time_limits
        )
        assert least(replace(asked, time_limits=tuple(raised))) < math.inf
        seen += 1
    assert seen >= 5


@pytest.mark.slow
@pytest.mark.parametrize("shared", [False, True])
def test_a_fleet_is_in_time(*, shared: bool) -> None:
    """600 components are joined first; each of 100 chains has to keep its pairs."""
    robot = random_robot(1, 600, 12, load=0.6)
    chains = [connector.between for connector in robot.connectors[::6]][:100]
    limits = tuple(
        TimeLimit(
            name=f"t{i}",
            limit=0.06 if shared else 0.012,
            runs=tuple(Run(component=name, seconds=0.005) for name in pair),
            hops=(Hop(between=pair, seconds=0.05),),
            shared=shared,
            price=0.01 * (i % 2),
        )
        for i, pair in enumerate(chains)
    )
    asked = replace(robot, time_limits=limits)
    found = plan.solve(asked, method="search", steps=100_000, why=False)
    arrays = arrays_of(asked)
    assert found.feasible
    assert not violations(arrays, found.placed)
    assert found.objective is not None
    expected = objective.terms(arrays, found.placed)
    assert found.objective.total == pytest.approx(expected.total)
    assert found.objective.time == pytest.approx(expected.time)
    assert len({each.name for each in found.times if each.seconds <= each.limit}) > 90


@pytest.mark.parametrize("seed", range(8))
def test_phases_as_one_problem_take_what_each_takes(seed: int) -> None:
    """Each has the CPU of its own columns, though the computers are the same."""
    random = Random(seed)
    first, second = (timed(random, problem(random, 4, 2)) for _ in range(2))
    second = replace(second, computers=first.computers, links=first.links)
    parts = [arrays_of(replace(p, soft_limits=())) for p in (first, second)]
    whole, alone = Native(merged(parts, {})), [Native(part) for part in parts]
    for placed in itertools.product(range(2), repeat=8):
        halves = [*placed[:4]], [*placed[4:]]
        each = [n.core.terms(h)[4] for n, h in zip(alone, halves, strict=True)]
        assert whole.core.terms([*placed])[4] == pytest.approx(sum(each))
