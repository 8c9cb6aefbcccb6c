"""One alternative is in every placement, and what is not known is no result."""

from typing import Any

import pytest
from msgspec.structs import replace

from poise import plan
from poise.errors import UsageError
from poise.model.robot import (
    Architecture,
    ComponentEntry,
    Computer,
    Connector,
    ConnectorEnd,
    Layer,
    Link,
    Objective,
    Robot,
)


def detector(name: str, quality: float, layer: Layer = "sequencing") -> Architecture:
    """Return an architecture that finds things in the camera's images."""
    need = {"gpu": 1.0, "cpu": 0.2} if name == "learned" else {"cpu": 0.2}
    component = ComponentEntry(name=f"{name}_finder", demand=need)
    return Architecture(
        name=name,
        function="find",
        layer=layer,
        home="head",
        quality=quality,
        components=(component,),
    )


@pytest.fixture
def robot() -> Robot:
    """Return a camera on one computer and a GPU on the other, 5 MB/s of 125 between."""
    images: dict[str, Any] = {"message": 1e6, "rate": 5.0}
    return Robot(
        name="finder",
        computers=(
            Computer(name="head", capacity={"cpu": 2.0, "gpu": 0.0}),
            Computer(name="body", capacity={"cpu": 2.0, "gpu": 1.0}),
        ),
        links=(Link(between=("head", "body"), bandwidth=125e6),),
        architectures=(
            Architecture(
                name="camera",
                function="see",
                home="head",
                components=(
                    ComponentEntry(name="camera", demand={"cpu": 0.2}, only=("head",)),
                ),
            ),
            detector("learned", 1.0),
            detector("simple", 0.6),
        ),
        connectors=tuple(
            Connector(
                between=(ConnectorEnd("camera"), ConnectorEnd(f"{name}_finder")),
                **images,
            )
            for name in ("learned", "simple")
        ),
    )


def test_the_better_alternative_is_worth_a_little_of_a_link(robot: Robot) -> None:
    """4 % of the link is no reason to leave the GPU idle."""
    result = plan.solve(plan.problem_of(robot))
    assert result.architectures == {"find": "learned"}
    assert result.placement == {"camera": "head", "learned_finder": "body"}


def test_the_file_weighs_quality(robot: Robot) -> None:
    """Where quality is worth a thousandth, the connector decides."""
    frugal = replace(robot, objective=Objective(balance=0.0, quality=0.001))
    result = plan.solve(plan.problem_of(frugal))
    assert result.architectures == {"find": "simple"}


def test_says_why_an_alternative_was_not_chosen(robot: Robot) -> None:
    problem = plan.problem_of(robot)
    placement = plan.solve(problem).placement
    for name in ("simple", "simple_finder"):
        found = plan.explain(problem, placement, name)
        assert isinstance(found, plan.Rejection)
        assert (found.architecture, found.chosen) == ("simple", "learned")
        assert found.change is not None
        assert found.change.total > 0
        assert found.change.quality == pytest.approx(0.4)
        assert "quality +0.4" in found.reason


def test_what_was_not_chosen_may_run_beside_other_alternatives(robot: Robot) -> None:
    """Beside `plain`, `simple` fits; beside `large`, which runs now, it does not."""
    large = ComponentEntry(name="large", demand={"cpu": 3.0})
    plain = ComponentEntry(name="plain", demand={"cpu": 1.5})
    talk = tuple(
        Architecture(name=c.name, function="talk", quality=quality, components=(c,))
        for c, quality in ((large, 1.0), (plain, 0.9))
    )
    big, small = (
        replace(a, components=(replace(a.components[0], demand={"cpu": cpu}),))
        for a, cpu in zip(robot.architectures[1:], (0.5, 2.0), strict=True)
    )
    computers = (Computer(name="head", capacity={"cpu": 3.5}),)
    asked = replace(robot, computers=computers, links=(), connectors=())
    asked = replace(asked, architectures=(big, small, *talk))
    problem = plan.problem_of(asked)
    result = plan.solve(problem)
    assert result.architectures == {"find": "learned", "talk": "large"}
    found = plan.explain(problem, result.placement, "simple")
    assert isinstance(found, plan.Rejection)
    assert found.objective is not None
    assert found.objective.quality == pytest.approx(0.4 + 0.1)
    assert found.change is not None
    assert found.change.quality == pytest.approx(0.4 + 0.1)


def test_static_places_one_alternative_and_is_never_below_the_least(
    robot: Robot,
) -> None:
    problem = plan.problem_of(robot)
    placement = plan.static(robot, problem)
    assert placement.keys() == {"camera", "learned_finder"}
    static = plan.evaluate(problem, placement, "static").objective
    best = plan.solve(problem)
    assert best.proven
    assert best.objective is not None
    assert static is not None
    assert static.total >= best.objective.total - 1e-9


def test_a_placement_of_both_alternatives_is_refused(robot: Robot) -> None:
    problem = plan.problem_of(robot)
    both = dict.fromkeys((c.name for c in problem.components), "head")
    with pytest.raises(UsageError, match="exactly one; this one has learned, simple"):
        plan.evaluate(problem, both)


def test_layers_below_are_not_chosen_among(robot: Robot) -> None:
    """Of two reactive architectures the first one listed runs, whatever is better."""
    camera, learned, simple = robot.architectures
    reactive = [replace(a, layer="reactive") for a in (simple, learned)]
    problem = plan.problem_of(replace(robot, architectures=(camera, *reactive)))
    assert [a.name for a in problem.architectures] == ["camera", "simple"]


def test_layers_below_are_never_put_aside(robot: Robot) -> None:
    """Both ask for 1.5 of 2 cores; the reactive one has the lowest priority."""
    big = (ComponentEntry(name="loop", demand={"cpu": 1.5}),)
    other = (ComponentEntry(name="talker", demand={"cpu": 1.5}, only=("head",)),)
    full = replace(
        robot,
        architectures=(
            Architecture(
                name="drive",
                function="drive",
                layer="reactive",
                home="head",
                priority=-5,
                components=big,
            ),
            Architecture(name="talk", function="talk", priority=9, components=other),
        ),
        connectors=(),
    )
    result = plan.solve(plan.problem_of(full), fewer=True)
    assert result.suspended == ("talk",)
    assert result.placement == {"loop": "head"}


def test_nothing_is_proven_without_any_demand(robot: Robot) -> None:
    blank = replace(
        robot,
        architectures=tuple(
            replace(a, components=tuple(replace(c, demand={}) for c in a.components))
            for a in robot.architectures
        ),
    )
    result = plan.solve(plan.problem_of(blank))
    assert result.feasible
    assert not result.proven
    assert result.bound is None
    assert result.unknown == tuple(result.placement)


def test_a_demand_of_zero_is_known(robot: Robot) -> None:
    idle = replace(
        robot,
        architectures=(
            Architecture(
                name="idle",
                function="idle",
                components=(ComponentEntry(name="idle", demand={"cpu": 0.0}),),
            ),
        ),
        connectors=(),
    )
    assert plan.solve(plan.problem_of(idle)).proven
