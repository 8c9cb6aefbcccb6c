"""No proof is wrong, and what is full to the last hundredth is found."""

from math import inf
from pathlib import Path

import pytest
from msgspec.structs import replace

from benchmarks.random_robots import random_robot
from poise import plan
from poise.model.robot import Objective
from poise.plan._core import Core
from poise.plan.problem.arrays import arrays_of
from tests.plan.plan_problems import least, small_robot

ROBOTS = Path(__file__).parent / "robots"
OPTIMA = {
    "memory_in_bytes": 0.125,
    "three_computers": 0.16951,
    "four_computers": 0.34647,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", OPTIMA)
def test_cpsat_proves_the_optimum_of_robots_with_memory_in_bytes(name: str) -> None:
    cpsat = pytest.importorskip("benchmarks.cpsat")
    problem = plan.load(ROBOTS / f"{name}.json")
    ours, theirs = plan.solve(problem, 60.0), cpsat.certificate(problem, 60.0)
    assert ours.proven
    assert theirs.proven
    assert ours.feasible
    assert ours.objective is not None
    for total in (ours.objective.total, theirs.objective):
        assert total == pytest.approx(OPTIMA[name], abs=1e-4)
    assert theirs.bound <= ours.objective.total


@pytest.mark.slow
def test_cpsat_counts_in_numbers_that_it_can_add() -> None:
    """No coefficient is above 10^7, the parts of a limit or of F."""
    cpsat = pytest.importorskip("benchmarks.cpsat")
    model = cpsat._Relaxation(arrays_of(plan.load(ROBOTS / "memory_in_bytes.json")))
    coefficients = [
        abs(number)
        for constraint in model.program.proto.constraints
        for number in constraint.linear.coeffs
    ]
    assert max(coefficients) <= 10**7


@pytest.mark.slow
def test_a_known_placement_is_not_proven_by_an_infeasible_model(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cpsat = pytest.importorskip("benchmarks.cpsat")
    arrays = arrays_of(plan.load(ROBOTS / "four_computers.json"))
    core = Core(arrays)
    known = core.search([], 1e9, 50_000, 1)[0]
    assert known

    def infeasible(*_: object) -> object:
        return cpsat._Solved("INFEASIBLE", [], float("-inf"))

    monkeypatch.setattr(cpsat, "_run", infeasible)
    answer = cpsat.solve(core, arrays, 1.0, known)
    assert answer.placed == known
    assert not answer.proven


@pytest.mark.slow
def test_what_cpsat_finds_is_verified(monkeypatch: pytest.MonkeyPatch) -> None:
    """A placement may break a limit that rounding hid, or be above what is proven."""
    cpsat = pytest.importorskip("benchmarks.cpsat")
    arrays = arrays_of(plan.load(ROBOTS / "three_computers.json"))
    core = Core(arrays)
    good, broken = core.search([], 1e9, 50_000, 1)[0], [0] * arrays.n
    assert not core.feasible(broken)
    for found in (broken, good):
        answers = [
            cpsat._Solved("UNKNOWN", [], -inf),
            cpsat._Solved("OPTIMAL", found, 0.1),
        ]
        monkeypatch.setattr(cpsat, "_run", lambda *_, left=answers: left.pop())
        certificate = cpsat.solve(core, arrays, 60.0)
        assert certificate.placed == ([] if found is broken else good)
        assert certificate.bound == pytest.approx(0.1)
        assert not certificate.proven


@pytest.mark.slow
@pytest.mark.parametrize("balance", [0.0, 0.5])
def test_the_model_of_cpsat_is_below_f_by_no_more_than_it_says(balance: float) -> None:
    """Every component is held where it is, so that the model has one placement."""
    cpsat = pytest.importorskip("benchmarks.cpsat")
    robot = random_robot(1, 20, 3, load=0.5)
    problem = replace(robot, objective=Objective(balance=balance))
    core = Core(arrays := arrays_of(problem))
    placed, complete = core.greedy()
    assert complete
    model = cpsat._Relaxation(arrays)
    for row, computer in zip(model.on, placed, strict=True):
        model.program.add(row[computer] == 1)
    total = sum(core.terms(placed))
    bound = cpsat._run(model, 60.0).bound
    assert total - model.error <= bound <= total


@pytest.mark.slow
@pytest.mark.parametrize("method", ["auto", "search"])
def test_places_a_robot_that_is_nearly_full(method: str) -> None:
    """98 % of its capacity is used, with links, sets and pins."""
    problem = plan.load(ROBOTS / "nearly_full.json")
    assert plan.solve(problem, method=method, steps=2_000_000).feasible


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("pinned", [0.02, 0.1])
def test_search_places_a_fleet_with_pins_and_load(pinned: float, seed: int) -> None:
    """A quarter is free; pins once made F seven times what it is without them."""
    problem = random_robot(seed, 2000, 40, load=0.75, pinned=pinned)
    greedy = plan.solve(problem, method="greedy").objective
    found = plan.solve(problem, method="search", steps=400_000, why=False)
    assert found.feasible
    assert greedy is not None
    assert found.objective is not None
    assert found.objective.total < greedy.total / 3


@pytest.mark.slow
@pytest.mark.parametrize("method", ["auto", "exact"])
def test_every_proof_is_that_of_brute_force(method: str) -> None:
    for seed in range(25):
        problem = small_robot(seed)
        optimum = least(problem)
        result = plan.solve(problem, 60.0, method, why=False)
        assert result.proven
        assert result.feasible == (optimum < inf)
        if result.objective is not None:
            assert result.objective.total == pytest.approx(optimum, abs=1e-4)
            assert result.bound is not None
            assert result.bound <= optimum + 1e-9


@pytest.mark.slow
def test_every_certificate_is_that_of_brute_force() -> None:
    cpsat = pytest.importorskip("benchmarks.cpsat")
    for seed in range(25):
        problem = small_robot(seed)
        optimum = least(problem)
        answer = cpsat.certificate(problem, 60.0)
        assert answer.proven
        assert bool(answer.placed) == (optimum < inf)
        if answer.placed:
            assert answer.objective == pytest.approx(optimum, abs=1e-4)
            assert answer.bound <= optimum + 1e-9
