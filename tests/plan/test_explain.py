"""Why a component is where it is, and what each other computer would cost."""

from collections.abc import Mapping

import pytest
from msgspec.structs import replace

from poise import plan
from poise.errors import UsageError
from poise.plan import Problem


def explained(
    problem: Problem, placement: Mapping[str, str], component: str
) -> plan.Explanation:
    found = plan.explain(problem, placement, component)
    assert isinstance(found, plan.Explanation)
    return found


def test_says_what_every_other_computer_would_cost(paper_example: Problem) -> None:
    """C3 on SBC1 gives F = 47.5: 25 more, by balance +30 and communication -5."""
    placement = plan.solve(paper_example).placement
    explanation = explained(paper_example, placement, "C3")
    assert explanation.computer == "SBC2"
    other = explanation.options[1]
    assert (other.computer, other.change.total) == ("SBC1", 25.0)
    assert (other.change.balance, other.change.communication) == (30.0, -5.0)
    assert "balance" in explanation.reason


def test_says_what_keeps_it_from_a_computer(two_computers: Problem) -> None:
    held = replace(two_computers.components[0], only=("large",), why="needs device eye")
    problem = replace(two_computers, components=(held, *two_computers.components[1:]))
    explanation = explained(problem, plan.solve(problem).placement, "a")
    assert explanation.reason == "no other computer can take it"
    assert "needs device eye" in explanation.options[1].obstacle


def test_names_what_must_come_along(two_computers: Problem) -> None:
    problem = replace(two_computers, together=(("a", "b"),))
    explanation = explained(problem, plan.solve(problem).placement, "a")
    assert explanation.together == ("b",)


def test_names_the_components_there_are(two_computers: Problem) -> None:
    with pytest.raises(UsageError, match="no component is called 'x'"):
        plan.explain(two_computers, plan.solve(two_computers).placement, "x")


def test_calls_no_architecture_rejected_that_has_no_components(
    two_computers: Problem,
) -> None:
    bundles = (
        plan.Bundle(name="plain", components=("a", "b"), function="see"),
        plan.Bundle(name="magnet", components=(), function="grasp"),
    )
    problem = replace(two_computers, architectures=bundles)
    with pytest.raises(UsageError, match="'magnet' was chosen, and has no component"):
        plan.explain(problem, plan.solve(problem).placement, "magnet")
