"""The paper's greedy, as the readable reference."""

from msgspec.structs import replace

from poise import plan
from poise.model.robot import Computer
from poise.plan import Item, Problem


def test_follows_the_papers_worked_example(paper_example: Problem) -> None:
    """C2: 40 on either. C1: 60 with C2 (residue 40 and 100), else 1.5*5 + 20 = 27.5.

    C3: on SBC1 (1.5 + 1)*5 + |45 - 80| = 47.5; on SBC2 (1.5 + 2)*5 + |60 - 65| = 22.5.
    The paper's text puts C3 on SBC1; its own formula, followed here, does not.
    """
    result = plan.solve(paper_example, method="greedy")
    tried = {
        step.component: [trial.total for trial in step.trials]
        for step in plan.solve(paper_example, method="greedy").trace
    }
    assert tried == {"C2": [40, 40], "C1": [60, 27.5], "C3": [47.5, 22.5]}
    assert result.placement == {"C2": "SBC1", "C1": "SBC2", "C3": "SBC2"}
    assert result.objective is not None
    assert result.objective.total == 22.5
    assert result.objective.communication == 17.5
    assert result.objective.balance == 5


def test_places_the_largest_first(paper_example: Problem) -> None:
    assert [s.component for s in plan.solve(paper_example, method="greedy").trace] == [
        "C2",
        "C1",
        "C3",
    ]


def test_places_pinned_components_before_larger_ones(two_computers: Problem) -> None:
    pinned = replace(two_computers.components[3], only=("small",))
    problem = replace(two_computers, components=(*two_computers.components[:3], pinned))
    result = plan.solve(problem, method="greedy")
    assert plan.solve(problem, method="greedy").trace[0].component == "d"
    assert result.placement["d"] == "small"


def test_places_components_that_must_be_together_as_one(
    two_computers: Problem,
) -> None:
    problem = replace(two_computers, together=(("a", "d"),))
    result = plan.solve(problem, method="greedy")
    assert plan.solve(problem, method="greedy").trace[0].component == "a+d"
    assert result.placement["a"] == result.placement["d"]


def test_keeps_components_apart(two_computers: Problem) -> None:
    problem = replace(two_computers, apart=(("a", "b"),))
    result = plan.solve(problem, method="greedy")
    assert result.placement["a"] != result.placement["b"]


def test_leaves_the_reserve_free() -> None:
    """A demand of 0.6 fits 1 core, but not 1 core of which half is kept free."""
    problem = Problem(
        components=(Item(name="a", demand={"cpu": 0.6}),),
        computers=(
            Computer(name="one", capacity={"cpu": 1.0}, reserve={"cpu": 0.5}),
            Computer(name="two", capacity={"cpu": 1.0}),
        ),
    )
    assert plan.solve(problem, method="greedy").placement == {"a": "two"}


def test_counts_speed_into_cpu_capacity_only() -> None:
    """0.5 cores at speed 2 carry a demand of 1; 0.5 of memory does not."""
    fast = Computer(name="fast", capacity={"cpu": 0.5, "memory": 0.5}, speed=2.0)
    cpu = Item(name="a", demand={"cpu": 1.0})
    memory = Item(name="a", demand={"memory": 1.0})
    assert plan.solve(Problem(components=(cpu,), computers=(fast,))).feasible
    assert not plan.solve(Problem(components=(memory,), computers=(fast,))).feasible


def test_says_what_no_computer_could_take() -> None:
    problem = Problem(
        components=(Item(name="giant", demand={"cpu": 9.0}),),
        computers=(Computer(name="one", capacity={"cpu": 1.0}),),
    )
    result = plan.solve(problem, method="greedy")
    assert not result.feasible
    assert result.placement == {}
    assert "giant" in result.reason
    assert "cpu" in result.reason
