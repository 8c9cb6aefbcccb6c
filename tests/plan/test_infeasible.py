"""An infeasible problem names what cannot hold together, and the cheapest way out."""

from msgspec.structs import replace

from poise import plan
from poise.plan import Component, Computer, Connector, Link, Problem


def computers(*sizes: float) -> tuple[Computer, ...]:
    return tuple(
        Computer(name=f"h{i}", capacity={"cpu": size}) for i, size in enumerate(sizes)
    )


def components(*demands: float) -> tuple[Component, ...]:
    return tuple(
        Component(name=f"c{i}", demand={"cpu": need}) for i, need in enumerate(demands)
    )


def test_names_a_component_that_is_too_large() -> None:
    result = plan.solve(Problem(components=components(1, 5), computers=computers(2, 4)))
    assert result.conflict is not None
    assert result.conflict.components == ("c1",)
    assert result.conflict.way_out == "at least 1 more cpu on h1"
    assert result.proven


def test_names_the_pinned_components_that_overfill_a_computer() -> None:
    """c1 and c2 are held to h0 and need 3 of its 2 cores; c0 is not to blame."""
    free, first, second = components(1, 1.5, 1.5)
    held = tuple(replace(c, only=("h0",)) for c in (first, second))
    result = plan.solve(Problem(components=(free, *held), computers=computers(2, 4)))
    assert result.conflict is not None
    assert set(result.conflict.components) == {"c1", "c2"}
    assert "h0" in result.conflict.limits[0]


def test_says_how_much_all_computers_are_short_of() -> None:
    result = plan.solve(
        Problem(components=components(2, 2, 2), computers=computers(2, 2.5))
    )
    assert "1.5 more cpu" in result.reason


def test_finds_what_cannot_be_packed() -> None:
    """Three of 2 need 6 of 3 + 3 in all, but no computer takes two of them."""
    problem = Problem(components=components(2, 2, 2, 0), computers=computers(3, 3))
    result = plan.solve(problem)
    assert not result.feasible
    assert result.conflict is not None
    assert set(result.conflict.components) == {"c0", "c1", "c2"}
    assert result.conflict.way_out.startswith("1 more cpu on h") or (
        "1.0" in result.conflict.way_out
    )


def test_the_way_out_leads_out() -> None:
    problem = Problem(components=components(2, 2, 2), computers=computers(3, 3))
    result = plan.solve(problem)
    assert result.conflict is not None
    amount, _, _, _, name = result.conflict.way_out.split()
    larger = tuple(
        replace(h, capacity={"cpu": 3 + float(amount)}) if h.name == name else h
        for h in problem.computers
    )
    assert plan.solve(replace(problem, computers=larger)).feasible


def test_names_components_that_must_be_together_and_apart() -> None:
    problem = Problem(
        components=components(1, 1),
        computers=computers(4, 4),
        together=(("c0", "c1"),),
        apart=(("c0", "c1"),),
    )
    result = plan.solve(problem)
    assert result.conflict is not None
    assert "together, and apart" in result.reason


def test_names_pins_that_contradict_a_set_that_must_be_together() -> None:
    first, second = components(1, 1)
    problem = Problem(
        components=(replace(first, only=("h0",)), replace(second, only=("h1",))),
        computers=computers(4, 4),
        together=(("c0", "c1"),),
    )
    result = plan.solve(problem)
    assert not result.feasible
    assert "no common computer" in result.reason


def test_names_the_link_that_is_too_slow() -> None:
    first, second = components(2, 2)
    problem = Problem(
        components=(first, second),
        computers=computers(3, 3),
        connectors=(Connector(between=("c0", "c1"), traffic=8.0),),
        links=(Link(between=("h0", "h1"), bandwidth=5.0),),
    )
    result = plan.solve(problem)
    assert not result.feasible
    assert "link h0 - h1" in result.reason


def test_the_greedy_says_where_it_came_to_a_dead_end() -> None:
    problem = Problem(components=components(2, 2, 2), computers=computers(3, 3))
    result = plan.solve(problem, method="greedy")
    assert not result.feasible
    assert "finds no computer for c2" in result.reason
