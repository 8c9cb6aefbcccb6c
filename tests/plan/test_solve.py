"""`solve`: methods, limits, present placement, interruption."""

import itertools
import subprocess
import sys
import threading
from typing import Any, cast

import pytest
from msgspec.structs import replace

from benchmarks.random_robots import random_robot
from poise import plan
from poise.errors import UsageError
from poise.plan import Problem
from poise.plan._core import Core
from poise.plan.planner import Effort, run_portfolio
from poise.plan.result import CompiledProblem
from tests.waiting import LONG


@pytest.mark.parametrize("method", ["auto", "greedy", "exact", "search"])
def test_every_method_places_a_robot(method: str) -> None:
    result = plan.solve(random_robot(1, 16, 2), method=method)
    assert result.feasible
    assert result.objective is not None
    assert result.bound is not None
    assert result.bound <= result.objective.total + 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("budget", [0.0, 1e-6, 1e-3, 0.05])
def test_is_never_worse_than_the_greedy(budget: float) -> None:
    for seed in range(8):
        robot = random_robot(seed, 30, 4)
        first = plan.solve(robot, method="greedy").objective
        best = plan.solve(robot, budget=budget).objective
        if first is not None:
            assert best is not None
            assert best.total <= first.total + 1e-9


def test_proves_a_small_robot() -> None:
    result = plan.solve(random_robot(2, 20, 2), budget=5.0)
    assert result.proven
    assert result.gap == 0
    assert result.stopped_by == "proven"


class Asked:
    """A core that notes what it was asked."""

    def __init__(self, core: Core) -> None:
        self._core = core
        self.names: list[str] = []

    def __getattr__(self, name: str) -> Any:
        self.names.append(name)
        return getattr(self._core, name)


def test_nothing_is_searched_where_a_proof_is_quick() -> None:
    compiled = CompiledProblem(random_robot(2, 20, 2))
    core = Asked(compiled.core)
    compiled.core = cast("Core", core)
    result = run_portfolio(compiled, "auto", Effort(60.0, None))
    assert result.proven
    assert core.names.count("exact") == 1
    assert "search" not in core.names


def test_steps_make_it_reproducible() -> None:
    robot = random_robot(3, 60, 5)
    runs = [plan.solve(robot, steps=30_000, seed=4) for _ in range(2)]
    assert runs[0].placement == runs[1].placement


def test_stays_when_nothing_is_better(two_computers: Problem) -> None:
    """The mirror image of an optimum is as good: the present one is kept."""
    small = two_computers.computers[1]
    equal = (replace(small, name="left"), replace(small, name="right"))
    start = plan.solve(replace(two_computers, computers=equal)).placement
    mirror = {c: "left" if h == "right" else "right" for c, h in start.items()}
    for placement in (start, mirror):
        moved = replace(
            two_computers,
            computers=equal,
            components=tuple(
                replace(c, present=placement[c.name]) for c in two_computers.components
            ),
        )
        assert plan.solve(moved).placement == placement


def test_moves_only_when_it_is_worth_the_cost(two_computers: Problem) -> None:
    def present(cost: float) -> Problem:
        return replace(
            two_computers,
            components=tuple(
                replace(c, present="large", move_cost=cost)
                for c in two_computers.components
            ),
        )

    assert set(plan.solve(present(10.0)).placement.values()) == {"large"}
    assert "small" in plan.solve(present(0.0)).placement.values()


def test_refuses_what_it_does_not_know(two_computers: Problem) -> None:
    with pytest.raises(UsageError, match=r"auto, greedy, exact, search\)"):
        plan.solve(two_computers, method="magic")
    with pytest.raises(UsageError, match="seed"):
        plan.solve(two_computers, seed=-1)
    with pytest.raises(UsageError, match="steps"):
        plan.solve(two_computers, steps=-1)
    with pytest.raises(UsageError, match=r"seed is 1\.5, must be a whole number"):
        plan.solve(two_computers, seed=1.5)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="stop is 3"):
        plan.solve(two_computers, stop=3)  # type: ignore[arg-type]


CTRL_C = """
import os, signal
from benchmarks.random_robots import random_robot
from poise import plan

pressed = []
def press():  # asked now and then while it searches
    if not pressed:
        pressed.append(True)
        os.kill(os.getpid(), signal.SIGINT)
    return False

result = plan.solve(random_robot(4, 80, 6), budget=600.0, method="search", stop=press)
print(result.stopped_by, result.feasible)
"""


@pytest.mark.slow
def test_ctrl_c_returns_the_best_so_far() -> (
    None
):  # in a process of its own to press in
    done = subprocess.run(
        [sys.executable, "-c", CTRL_C],
        capture_output=True,
        text=True,
        timeout=LONG,
        check=False,
    )
    assert (done.stdout, done.stderr) == ("interrupted True\n", "")


@pytest.mark.slow
@pytest.mark.parametrize("method", ["auto", "exact", "search"])
def test_any_thread_is_told_to_stop(method: str) -> None:
    robot = random_robot(4, 80, 6)
    asked, results = itertools.count(), []

    def work() -> None:
        results.append(plan.solve(robot, 600.0, method, stop=lambda: next(asked) > 2))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join(60)
    (result,) = results
    assert result.stopped_by == "interrupted"
    assert result.feasible
    assert not result.proven


def test_what_a_question_to_stop_raises_is_raised() -> None:
    def ask() -> bool:
        raise LookupError

    with pytest.raises(LookupError):
        plan.solve(random_robot(4, 80, 6), 600.0, stop=ask)


def test_many_pinned_components_do_not_spoil_a_fleet() -> None:
    """Joined units are held to one computer each: then a finer level begins."""
    problem = random_robot(1, 1200, 60, load=0.75, pinned=0.12)
    greedy = plan.solve(problem, method="greedy").objective
    found = plan.solve(problem, steps=60_000, why=False).objective
    assert greedy is not None
    assert found is not None
    assert found.total < 0.6 * greedy.total
