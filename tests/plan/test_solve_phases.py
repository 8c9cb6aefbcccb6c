"""The phases of a task are placed so that little moves between them."""

from collections.abc import Mapping
from itertools import pairwise, product
from random import Random

import pytest
from msgspec.structs import replace

from benchmarks.random_robots import random_robot
from poise import plan
from poise.errors import RobotError, UsageError
from poise.model.robot import Computer, Link, Objective
from poise.plan import Bundle, Edge, Item, Problem, _core
from poise.plan.phase_problem import NEVER
from poise.plan.phase_search import Unit, merged
from poise.plan.problem.arrays import arrays_of
from poise.plan.result import CompiledProblem

HALVES = tuple(Computer(name=name, capacity={"cpu": 0.5}) for name in ("one", "two"))


def item(name: str, cpu: float = 0.3, *only: str) -> Item:
    return Item(name=name, demand={"cpu": cpu}, only=only)


def in_turn(
    *problems: Problem, move: Mapping[str, float] | None = None
) -> plan.TaskProblem:
    """Return phases p0, p1 and so on, of a second each; a move costs 0.01."""
    names = {c.name for problem in problems for c in problem.components}
    return plan.TaskProblem(
        phases=tuple(
            plan.PhaseProblem(
                name=f"p{i}", problem=problem, after={f"p{i - 1}": 1.0} if i else {}
            )
            for i, problem in enumerate(problems)
        ),
        move={**dict.fromkeys(names, 0.01), **(move or {})},
    )


def alone(*components: Item) -> Problem:
    return Problem(components=components, computers=HALVES)


def test_says_all_that_is_wrong_with_phases() -> None:
    a = plan.PhaseProblem(name="a", problem=alone(item("x")))
    other = Problem(computers=HALVES[:1])
    wrong = plan.PhaseProblem(name="a", problem=other, after={"b": -1.0}, lasts=0.0)
    with pytest.raises(RobotError) as found:
        plan.TaskProblem(phases=(a, wrong))
    assert str(found.value).splitlines() == [
        "the phases are wrong:",
        "  phase 'a' is there 2 times; names must be unique",
        "  phase 'a': lasts is 0.0, must be finite and above 0",
        "  phase 'a': there is no phase 'b'; phases: 'a'",
        "  phase 'a': after 'b' is -1.0, must be finite and >= 0",
        "  phase 'a': its computers are not those of 'a'",
    ]
    with pytest.raises(RobotError, match="a task has one at least"):
        plan.TaskProblem(phases=())


def test_three_actions_that_do_not_fit_at_once_fit_one_after_the_other() -> None:
    """0.3 of a core each, on two computers of 0.5: two at once, but not three."""
    a, b, c = item("a"), item("b"), item("c")
    assert not plan.solve(alone(a, b, c)).feasible
    result = plan.solve_phases(in_turn(alone(a), alone(b), alone(c)))
    assert result.feasible
    assert result.proven
    assert result.reason == ""
    assert result.moves == ()


def test_a_component_stays_where_it_is_best_over_all_phases() -> None:
    """Two phases pin a rival to one: `a` is on two, and in the first phase as well."""
    a, rival = item("a"), item("r", 0.3, "one")
    first = alone(replace(a, cost={"two": 0.005}))
    problem = in_turn(first, alone(a, rival), alone(a, rival))
    result = plan.solve_phases(problem)
    assert [r.placement["a"] for r in result.results.values()] == ["two"] * 3
    assert result.moves == ()
    # A move that is cheaper than that is made.
    cheap = plan.solve_phases(replace(problem, move={"a": 0.001}))
    (move,) = cheap.moves
    assert (move.component, move.before, move.after) == ("a", "p0", "p1")
    assert (move.source, move.target) == ("one", "two")


def test_one_phase_is_placed_as_without_phases() -> None:
    problem = random_robot(3, 24, 3)
    one = plan.solve_phases(plan.TaskProblem.of_one("all", problem), steps=20_000)
    same = plan.solve(problem, steps=20_000)
    assert same.objective is not None
    assert one.only[1].placement == same.placement
    assert one.total == same.objective.total
    assert (one.bound, one.proven) == (same.bound, same.proven)


def random_task(seed: int) -> plan.TaskProblem:
    """Return three phases of up to four components on two computers."""
    random = Random(seed)
    names = [f"c{i}" for i in range(4)]
    demand = {name: random.uniform(0.05, 0.4) for name in names}
    pairs = [(a, b) for a in names for b in names if a < b and random.random() < 0.6]
    computers = tuple(
        Computer(name=name, capacity={"cpu": random.uniform(0.8, 1.2)})
        for name in ("one", "two")
    )
    whole = Problem(
        components=tuple(item(name, cpu) for name, cpu in demand.items()),
        computers=computers,
        connectors=tuple(
            Edge(between=pair, overhead=random.uniform(0.1, 1)) for pair in pairs
        ),
    )
    kept = [random.sample(names, random.randint(1, 4)) for _ in range(3)]
    return in_turn(*(plan.keep_components(whole, some) for some in kept))


def least(problem: plan.TaskProblem) -> float:
    """Return the least total of all placements, by trying all: F over three seconds."""
    options = []
    for phase in problem.phases:
        compiled = CompiledProblem(phase.problem)
        arrays = compiled.arrays
        options.append(
            [
                (compiled.terms([*placed]).total, arrays.placement([*placed]))
                for placed in product(range(arrays.m), repeat=arrays.n)
                if compiled.core.feasible([*placed])
            ]
        )
    return min(
        sum(f for f, _ in chosen)
        + sum(
            problem.move[name]
            for (_, one), (_, two) in pairwise(chosen)
            for name in one.keys() & two.keys()
            if one[name] != two[name]
        )
        for chosen in product(*options)
    ) / len(problem.phases)


@pytest.mark.parametrize("seed", range(12))
def test_it_is_the_best_of_all_placements_of_small_robots(seed: int) -> None:
    problem = random_task(seed)
    result = plan.solve_phases(problem, steps=20_000)
    assert result.total == pytest.approx(least(problem))
    assert result.bound is None or result.bound <= least(problem) + 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_phases_as_one_problem_have_the_same_total(seed: int) -> None:
    """And CP-SAT finds no less there."""
    cpsat = pytest.importorskip("benchmarks.cpsat")
    problem = random_task(seed)
    parts = [arrays_of(phase.problem) for phase in problem.phases]
    moves: dict[tuple[Unit, Unit], float] = {}
    for p in range(2):
        here, there = parts[p].index, parts[p + 1].index
        for name in here.keys() & there.keys():
            moves[(p, here[name]), (p + 1, there[name])] = problem.move[name]
    core = _core.Core(merged(parts, moves))
    found = cpsat.solve(core, merged(parts, moves), 20.0)
    assert found.proven
    assert found.objective == pytest.approx(3 * least(problem), abs=1e-5)
    greedy, is_complete = core.greedy()
    assert is_complete
    placed = core.search(greedy, 9.0, 20_000, 0)[0]
    result = plan.solve_phases(problem, steps=20_000)
    assert result.total is not None
    assert 3 * result.total <= sum(core.terms(placed)) + 1e-9


def test_what_may_not_be_moved_is_in_one_place() -> None:
    """`a` would be on one in the first phase, but a rival takes that in the second."""
    a, rival = item("a"), item("r", 0.3, "one")
    first = alone(replace(a, cost={"two": 0.4}))
    result = plan.solve_phases(in_turn(first, alone(a, rival), move={"a": NEVER}))
    assert result.feasible
    assert result.results["p0"].placement["a"] == "two"


def test_says_that_a_component_would_have_to_move_that_may_not() -> None:
    one, two = item("r", 0.3, "one"), item("s", 0.3, "two")
    result = plan.solve_phases(
        in_turn(alone(item("a"), one), alone(item("a"), two), move={"a": NEVER})
    )
    assert not result.feasible
    assert "'a' may not be moved while it runs" in result.reason
    assert "'p0' and 'p1'" in result.reason


def test_says_which_phase_does_not_fit_and_places_the_others() -> None:
    result = plan.solve_phases(in_turn(alone(item("a")), alone(item("b", 0.6))))
    assert not result.feasible
    assert result.proven
    assert result.reason.startswith("phase 'p1': b needs 0.6 cpu")
    assert result.results["p0"].feasible
    assert result.total is None
    with pytest.raises(UsageError, match="phase 'p1' has no placement"):
        result.explain("p1", "b")


def with_alternatives(*components: Item) -> Problem:
    """Return a phase whose function `f` is served by `good` or by `poor`."""
    return replace(
        alone(item("good"), item("poor", 0.1), *components),
        architectures=(
            Bundle(name="good", components=("good",), function="f"),
            Bundle(name="poor", components=("poor",), function="f", quality=0.9),
            *(Bundle(name=c.name, components=(c.name,)) for c in components),
        ),
        objective=Objective(quality=0.01),
    )


def test_a_function_is_served_by_one_architecture_where_a_change_costs_more() -> None:
    """The second phase has room for `poor` only; `good` first would be a start more."""
    full = with_alternatives(item("r", 0.3, "one"), item("s", 0.4, "two"))
    problem = in_turn(with_alternatives(), full, move={"good": 1.0, "poor": 1.0})
    result = plan.solve_phases(problem)
    chosen = [r.architectures for r in result.results.values()]
    assert chosen == [{"f": "poor"}, {"f": "poor"}]


def test_links_keep_their_bandwidth_in_every_phase() -> None:
    """`b` is held to two: `a` joins it, though it is cheaper to stay on one."""
    a, b, rival = item("a", 0.1), item("b", 0.1, "two"), item("r", 0.1, "one")
    linked = replace(
        alone(a, b, rival),
        connectors=(Edge(between=("a", "b"), overhead=0.0, traffic=10.0),),
        links=(Link(between=("one", "two"), bandwidth=1.0),),
    )
    first = alone(replace(a, cost={"two": 0.5}), rival)
    result = plan.solve_phases(in_turn(first, linked, first, move={"a": 0.3}))
    assert [r.placement["a"] for r in result.results.values()] == ["one", "two", "one"]
    assert all(r.feasible for r in result.results.values())


def test_an_explanation_counts_moves() -> None:
    a, rival = item("a"), item("r", 0.3, "one")
    result = plan.solve_phases(in_turn(alone(a), alone(a, rival), move={"a": 0.2}))
    explanation = result.explain("p0", "a")
    assert isinstance(explanation, plan.Explanation)
    there = next(o for o in explanation.options if o.computer == "one")
    assert there.change.move == pytest.approx(0.2)
    with pytest.raises(UsageError, match="there is no phase 'p2'"):
        result.explain("p2", "a")


def test_stops_when_it_is_told_to() -> None:
    problem = random_task(1)
    result = plan.solve_phases(problem, 60.0, "search", stop=lambda: True)
    assert result.stopped_by == "interrupted"


def test_the_cheapest_computers_for_tasks_one_at_a_time() -> None:
    """Two tasks fit on the cheap computer one at a time; a third needs the dear one."""
    computers = tuple(
        Computer(name=name, capacity={"cpu": cpu}, price=price)
        for name, cpu, price in (("cheap", 0.5, 10), ("dear", 1.0, 30), ("old", 0.2, 1))
    )

    def task(cpu: float) -> plan.TaskProblem:
        return in_turn(Problem(components=(item("a", cpu),), computers=computers))

    few = plan.smallest([task(0.5), task(0.4)], plan.solve_phases)
    assert few.computers == ("cheap",)
    assert few.proven
    assert [r.feasible for r in few.results] == [True, True]
    assert plan.smallest([task(0.5), task(0.9)], plan.solve_phases).computers == (
        "dear",
    )
    none = plan.smallest([task(0.5), task(2.0)], plan.solve_phases)
    assert none.computers == ("cheap", "dear", "old")
    assert [r.feasible for r in none.results] == [True, False]


def test_what_is_interrupted_has_not_looked_at_each_set_of_computers() -> None:
    """Of four components one fits on each of the cheap ones, two on the dear one."""
    computers = tuple(
        Computer(name=f"h{i}", capacity={"cpu": cpu}, price=price)
        for i, (cpu, price) in enumerate([(1.0, 1), (1.0, 1), (1.0, 1), (1.2, 2.5)])
    )
    components = tuple(item(f"c{i}", 0.6) for i in range(4))
    task = in_turn(Problem(components=components, computers=computers))

    def interrupted(problem: plan.TaskProblem) -> plan.TaskResult:
        result = plan.solve_phases(problem, why=False)
        if result.proven and not result.feasible:
            result.stopped_by = "interrupted"
        return result

    assert plan.smallest([task], plan.solve_phases).computers == ("h0", "h1", "h3")
    few = plan.smallest([task], interrupted)
    assert few.computers == ("h0", "h1", "h2", "h3")
    assert not few.proven


def test_nothing_is_suspended_so_that_less_moves() -> None:
    """With `a` and `b` where they were before, the others do not fit beside them."""
    big = (item("a", 0.2, "one"), item("b", 0.2, "one"))
    small = [item(name, 0.15) for name in ("c", "d", "e", "f")]
    every = (*(replace(c, only=()) for c in big), *small)
    bundles = (Bundle(name=c.name, components=(c.name,)) for c in every)
    then = replace(alone(*every), architectures=tuple(bundles))
    task = in_turn(alone(*big), then, move={"a": 10.0, "b": 10.0})
    assert plan.solve(then, method="greedy", fewer=True).suspended == ()
    result = plan.solve_phases(task, method="greedy", fewer=True)
    assert result.results["p1"].suspended == ()


def test_phases_with_other_priorities_share_cpu_as_one_problem() -> None:
    """Each priority has a soft limit of its own; F of both adds up."""
    one, two, three = item("a", 0.4), item("b", 0.4), item("c", 0.4)

    def shared(*components: Item) -> Problem:
        bundles = (
            Bundle(name=c.name, components=(c.name,), priority=i)
            for i, c in enumerate(components)
        )
        return plan.share_cpu(replace(alone(*components), architectures=tuple(bundles)))

    first, second = shared(one), shared(one, two, three)
    arrays = [arrays_of(problem) for problem in (first, second)]
    core = _core.Core(merged(arrays, {}))
    placed = [[0], [0, 0, 1]]
    apart = [_core.Core(a).terms(p) for a, p in zip(arrays, placed, strict=True)]
    whole = core.terms([0, 0, 0, 1])
    assert sum(whole) == pytest.approx(sum(map(sum, apart)))
    assert sum(whole) > plan.PRICE * 0.29  # 0.8 of 0.5 cores
    result = plan.solve_phases(in_turn(first, second, shared(two, three)), steps=2000)
    assert result.feasible


def test_a_phase_is_found_by_what_runs_in_it() -> None:
    """`b` runs only where nothing fits, `a` everywhere, `z` nowhere."""
    first, second = alone(item("a"), item("b", 0.6)), alone(item("a"))
    result = plan.solve_phases(in_turn(first, second))
    assert result.first_with("a") == "p1"
    assert result.first_with("b") == "p0"
    with pytest.raises(UsageError, match=r"no component is called 'z' \(.*: a, b\)"):
        result.first_with("z")
    with pytest.raises(UsageError, match=r"phase 'p0' has no placement: b needs 0\.6"):
        result.explain("p0", "b")
    with pytest.raises(UsageError, match="'b' is not in phase 'p1'; it is in: p0"):
        result.explain("p1", "b")
