"""F of a task is the mean over its time: phases count by how long they are expected."""

from pathlib import Path

import pytest
from msgspec.structs import replace

from poise import plan
from poise.model import load
from poise.model.robot import Computer, Robot
from poise.plan import Bundle, Edge, Item, Problem
from poise.plan.phase_problem import NEVER

HALVES = tuple(Computer(name=name, capacity={"cpu": 0.5}) for name in ("one", "two"))


def leaning(where: str, cost: float) -> Problem:
    """Return a problem in which `a` costs something on one of the computers."""
    item = Item(name="a", demand={"cpu": 0.1}, cost={where: cost})
    return Problem(components=(item,), computers=HALVES)


def in_turn(
    first: plan.PhaseProblem, then: plan.PhaseProblem, move: float = NEVER
) -> plan.TaskProblem:
    then = replace(then, after={first.name: 1.0})
    return plan.TaskProblem(phases=(first, then), move={"a": move})


def phase(name: str, problem: Problem, seconds: float) -> plan.PhaseProblem:
    return plan.PhaseProblem(name=name, problem=problem, lasts=seconds)


def homes(result: plan.TaskResult) -> list[str]:
    return [each.placement["a"] for each in result.results.values()]


def test_an_hour_counts_more_than_a_second() -> None:
    """One costs 0.1 in the hour, two costs 0.5 in the second; `a` may not move."""
    hour = phase("hour", leaning("one", 0.1), 3600.0)
    second = phase("second", leaning("two", 0.5), 1.0)
    for problem in (in_turn(hour, second), in_turn(second, hour)):
        result = plan.solve_phases(problem, steps=1_000)
        assert homes(result) == ["two", "two"]
        alone = {name: r.objective for name, r in result.results.items()}
        assert alone["hour"] is not None
        assert alone["second"] is not None
        assert result.total == pytest.approx(
            (3600 * alone["hour"].total + alone["second"].total) / 3601
        )
    same = in_turn(replace(hour, lasts=1.0), second)
    assert homes(plan.solve_phases(same, steps=1_000)) == ["one", "one"]


def test_a_move_costs_work_once_and_a_place_all_the_time() -> None:
    """Two costs 0.1 for 30 s: 3 core-seconds; so a move of 2 is worth it, not of 4."""
    first, then = leaning("one", 0.1), leaning("two", 0.1)
    for move, moves in ((2.0, 1), (4.0, 0)):
        problem = in_turn(phase("p", first, 3000.0), phase("q", then, 30.0), move)
        result = plan.solve_phases(problem, steps=1_000)
        assert len(result.moves) == moves
    problem = in_turn(phase("p", first, 3000.0), phase("q", then, 30.0), 2.0)
    result = plan.solve_phases(problem, steps=1_000)
    assert result.of_moves == pytest.approx(2.0 / 3030)
    # 0.1 more for all its 30 s, less 2 core-seconds
    explanation = result.explain("q", "a")
    assert isinstance(explanation, plan.Explanation)
    there = next(o for o in explanation.options if o.computer == "two")
    assert there.change.total == pytest.approx(0.1 - 2.0 / 30)


def test_overhead_is_a_share_of_what_phases_have_in_the_mean() -> None:
    """9 for a second and 1 for seven are 2 in the mean: cutting 1 costs 0.5 * 1/2."""

    def talking(overhead: float) -> Problem:
        one, two = (Item(name=n, demand={"cpu": 0.3}) for n in "ab")
        edge = Edge(between=("a", "b"), overhead=overhead)
        return Problem(components=(one, two), computers=HALVES, connectors=(edge,))

    problem = in_turn(phase("p", talking(9.0), 1.0), phase("q", talking(1.0), 7.0), 0.0)
    terms = [
        r.objective for r in plan.solve_phases(problem, steps=1_000).results.values()
    ]
    assert [t.communication for t in terms if t] == pytest.approx([0.5 * 4.5, 0.25])


def test_phases_have_one_scale_also_with_alternatives_and_without_a_computer() -> None:
    pair = tuple(Item(name=n, demand={"cpu": 0.2}) for n in "abc")
    whole = Problem(
        components=pair,
        computers=HALVES,
        connectors=(
            Edge(between=("a", "b"), overhead=3.0),
            Edge(between=("a", "c"), overhead=1.0),
        ),
        architectures=(
            Bundle(name="base", components=("a",)),
            Bundle(name="B", function="f", components=("b",), quality=0.5),
            Bundle(name="C", function="f", components=("c",)),
        ),
    )
    part = replace(
        whole,
        components=pair[:1],
        connectors=(),
        architectures=whole.architectures[:1],
    )
    problem = in_turn(phase("p", whole, 1.0), phase("q", part, 1.0))
    # C, which is better, has 1 with the base; half of the time
    assert [p.problem.overhead_scale for p in problem.phases] == [2.0, 2.0]
    fewer = problem.changed(lambda each: plan.without(each, ["two"]))
    assert [p.problem.overhead_scale for p in fewer.phases] == [2.0, 2.0]


ROBOT = """
robot: r
computers: {left: {cpu: 1, memory: 1 GiB}, right: {cpu: 1, memory: 1 GiB}}
devices: {camera: {computer: left}, microphone: {computer: right}}
architectures:
  mind: {function: think, components: {mind: {movable: false, cpu: 10%}}}
  see: {function: see, components: {eyes: {devices: [camera], cpu: 10%}}}
  hear: {function: hear, components: {ears: {devices: [microphone], cpu: 10%}}}
connectors:
  - {between: [eyes.out, mind.seen], overhead: 1}
  - {between: [ears.out, mind.heard], overhead: 1}
tasks:
  long: {actions: [SEE 1 h}, HEAR 1 s}]}
  late: {actions: [SEE 1 s}, HEAR 1 h}]}
  rare: {actions: [SEE 9 s, on failure: {retry: 4, then: HEAR 60 s}}}]}
"""


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    """Return a robot whose mind is best beside its eyes, or else beside its ears."""
    see, hear = (
        f"{{name: {n}, functions: [think, {n}], limit:" for n in ("see", "hear")
    )
    path = tmp_path / "robot.yaml"
    path.write_text(ROBOT.replace("SEE", see).replace("HEAR", hear))
    return load(path)


@pytest.mark.parametrize(
    ("task", "where"), [("long", "left"), ("late", "right"), ("rare", "left")]
)
def test_a_component_that_may_not_move_is_where_it_works_longest(
    robot: Robot, task: str, where: str
) -> None:
    """`rare` hears in 1/32 of its runs, for 2 s in the mean, and sees for 17 s."""
    problem = plan.task_problem_of(robot, task)
    result = plan.solve_phases(problem, steps=1_000)
    assert result.feasible
    assert {r.placement["mind"] for r in result.results.values()} == {where}
