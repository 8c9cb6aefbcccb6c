"""Priorities and alternatives: what is suspended, and which architecture is chosen."""

import pytest
from msgspec.structs import replace

from poise import plan
from poise.errors import UsageError
from poise.model.robot import Computer, Objective
from poise.plan import Bundle, Item, Problem


def problem(*architectures: tuple[Bundle, float], room: float) -> Problem:
    """Return one component with a demand of cpu for each architecture."""
    return Problem(
        components=tuple(
            Item(name=a.components[0], demand={"cpu": need})
            for a, need in architectures
        ),
        computers=(Computer(name="one", capacity={"cpu": room}),),
        architectures=tuple(a for a, _ in architectures),
    )


def architecture(name: str, **more: object) -> Bundle:
    fields = {"name": name, "components": (f"{name}.part",), "function": name, **more}
    return Bundle(**fields)  # type: ignore[arg-type]


def test_puts_the_lowest_priority_aside() -> None:
    asked = problem(
        (architecture("talk", priority=1), 1.0),
        (architecture("drive", priority=5), 1.0),
        (architecture("see", priority=3), 1.0),
        room=2.0,
    )
    result = plan.solve(asked, fewer=True)
    assert result.suspended == ("talk",)
    assert set(result.placement) == {"drive.part", "see.part"}
    assert result.feasible
    # All three need 3 cores, and there are 2.
    assert "together need 3 cpu; one has 2" in result.reason
    assert "It would fit with 1 more cpu on one" in result.reason
    assert result.conflict is not None


def test_says_that_not_all_fits_where_no_more_is_asked() -> None:
    asked = problem((architecture("a"), 2.0), (architecture("b"), 2.0), room=3.0)
    result = plan.solve(asked, fewer=True, why=False)
    assert result.feasible
    assert result.reason == "no placement keeps all limits"
    assert result.conflict is not None  # now it was asked for
    assert "together need 4 cpu; one has 3" in result.reason


def test_puts_aside_as_few_as_possible() -> None:
    """Of equal priority: dropping the one of 2 is enough, two of 1 would be two."""
    asked = problem(
        (architecture("a"), 1.0),
        (architecture("b"), 1.0),
        (architecture("c"), 2.0),
        room=2.0,
    )
    assert plan.solve(asked, fewer=True).suspended == ("c",)


def test_counts_a_component_that_two_architectures_share_once() -> None:
    """The first two need 2.8 together; each of them with the third 3.3."""
    needs = {"base": 2.0, "a": 0.4, "b": 0.4, "c": 0.9}
    parts = {"first": ("base", "a"), "second": ("base", "b"), "third": ("c",)}
    asked = Problem(
        components=tuple(Item(name=n, demand={"cpu": x}) for n, x in needs.items()),
        computers=(Computer(name="one", capacity={"cpu": 3.0}),),
        architectures=tuple(Bundle(name=n, components=p) for n, p in parts.items()),
    )
    assert plan.solve(asked, fewer=True).suspended == ("third",)


def test_keeps_a_low_priority_that_still_fits() -> None:
    asked = problem(
        (architecture("high", priority=2), 3.0),
        (architecture("middle", priority=1), 3.0),
        (architecture("low", priority=0), 1.0),
        room=4.0,
    )
    assert plan.solve(asked, fewer=True).suspended == ("middle",)


def test_puts_nothing_aside_unless_asked() -> None:
    asked = problem((architecture("a"), 2.0), (architecture("b"), 2.0), room=3.0)
    result = plan.solve(asked)
    assert not result.feasible
    assert result.suspended == ()


def test_chooses_the_better_alternative_that_fits() -> None:
    alternatives = (
        (architecture("good", function="see", quality=1.0), 2.0),
        (architecture("plain", function="see", quality=0.5), 1.0),
    )
    roomy, tight = (problem(*alternatives, room=room) for room in (4.0, 1.5))
    assert plan.solve(roomy).architectures == {"see": "good"}
    result = plan.solve(tight)
    assert result.architectures == {"see": "plain"}
    assert result.objective is not None
    assert result.objective.quality == 0.5


def test_takes_a_lesser_alternative_before_putting_something_aside() -> None:
    asked = problem(
        (architecture("good", function="see", quality=1.0), 2.0),
        (architecture("plain", function="see", quality=0.5), 1.0),
        (architecture("drive"), 2.0),
        room=3.0,
    )
    result = plan.solve(asked, fewer=True)
    assert result.suspended == ()
    assert result.architectures == {"see": "plain"}


@pytest.mark.parametrize("priority", [1, 9])
def test_says_with_which_alternative_all_would_fit(priority: int) -> None:
    """Whether both alternatives are suspended, or one of them is taken."""
    asked = problem(
        (architecture("good", function="see", priority=priority), 2.0),
        (architecture("plain", function="see", priority=priority), 1.0),
        (architecture("drive", priority=5), 2.0),
        room=2.5,
    )
    result = plan.solve(asked, fewer=True)
    assert result.suspended == (("good",) if priority == 1 else ("drive",))
    assert "together need 3 cpu; one has 2.5. It would fit with 0.5" in result.reason


@pytest.mark.parametrize("fewer", [False, True])
def test_says_with_which_alternative_what_is_required_would_fit(*, fewer: bool) -> None:
    see = {"function": "see", "required": True}
    asked = problem(
        (architecture("good", **see), 4.0),
        (architecture("plain", **see), 3.0),
        room=2.5,
    )
    assert "It would fit with 0.5" in plan.solve(asked, fewer=fewer).reason


def test_weighs_quality_against_fit() -> None:
    """With quality worth nothing, the alternative with the lower F is taken."""
    asked = problem(
        (architecture("good", function="see", quality=1.0), 2.0),
        (architecture("plain", function="see", quality=0.5), 1.0),
        room=4.0,
    )
    two = replace(
        asked,
        computers=(*asked.computers, Computer(name="two", capacity={"cpu": 4.0})),
    )
    for quality, chosen in ((0.0, "plain"), (5.0, "good")):
        weighed = replace(two, objective=Objective(quality=quality))
        assert plan.solve(weighed).architectures == {"see": chosen}


def test_the_way_out_is_that_of_the_alternative_that_needs_least() -> None:
    asked = problem(
        (architecture("big", function="see"), 0.9),
        (architecture("small", function="see", quality=0.5), 0.55),
        (architecture("go"), 0.5),
        room=1.0,
    )
    result = plan.solve(asked)
    assert not result.feasible
    assert result.proven
    assert "small.part, go.part together need 1.05 cpu" in result.reason
    assert "It would fit with 0.05 more cpu on one" in result.reason
    assert result.conflict is not None
    assert result.conflict.price == 0.05


def test_an_alternative_that_may_run_nowhere_else_is_left_out_with_its_computer() -> (
    None
):
    """So fewer computers will do; a function that nothing else provides is told."""
    pinned = (architecture("good", function="see"), 0.5)
    plain = (architecture("plain", function="see", quality=0.5), 0.5)
    one, two = (Computer(name=name, capacity={"cpu": 1.0}) for name in ("one", "two"))

    def held(*architectures: tuple[Bundle, float]) -> Problem:
        asked = problem(*architectures, room=1.0)
        first, *others = asked.components
        components = replace(first, only=("one",)), *others
        return replace(asked, components=components, computers=(one, two))

    left = plan.solve(plan.without(held(pinned, plain), ["one"]))
    assert left.placement == {"plain.part": "two"}
    other = (architecture("drive"), 0.75)
    few = held(pinned, plain, other)
    few = replace(few, computers=(replace(one, price=3.0), two, replace(one, name="x")))
    found = plan.smallest([plan.TaskProblem.of_one("all", few)], plan.solve_phases)
    assert found.computers == ("two", "x")
    with pytest.raises(UsageError, match=r"these can run nowhere: good\.part"):
        plan.without(held(pinned, other), ["one"])


def test_with_fewer_what_a_lost_computer_strands_is_suspended() -> None:
    asked = problem((architecture("see"), 0.5), (architecture("drive"), 0.5), room=1.0)
    first, *others = asked.components
    one, two = (Computer(name=name, capacity={"cpu": 1.0}) for name in ("one", "two"))
    asked = replace(
        asked,
        components=(replace(first, only=("one",)), *others),
        computers=(one, two),
    )
    fewer = plan.solve(plan.without(asked, ["one"], fewer=True), fewer=True)
    assert fewer.placement == {"drive.part": "two"}
    assert fewer.suspended == ("see",)
    assert fewer.reason.startswith("see.part can run nowhere (only one).")
    see, drive = asked.architectures
    needed = replace(asked, architectures=(replace(see, required=True), drive))
    with pytest.raises(UsageError, match=r"these can run nowhere: see\.part"):
        plan.without(needed, ["one"], fewer=True)


def test_a_placement_with_an_alternative_without_components_can_be_evaluated() -> None:
    """Nothing is placed for it, so it is what a placement without the other has."""
    asked = replace(
        problem((architecture("arm", function="grasp", quality=0.5), 0.5), room=1.0),
        architectures=(
            Bundle(name="magnet", components=(), function="grasp"),
            architecture("arm", function="grasp", quality=0.5),
            Bundle(name="glue", components=(), function="grasp", quality=0.7),
        ),
    )
    best = plan.solve(asked)
    assert best.architectures == {"grasp": "magnet"}
    again = plan.evaluate(asked, best.placement)
    assert again.architectures == {"grasp": "magnet"}
    other = plan.evaluate(asked, {"arm.part": "one"})
    assert other.architectures == {"grasp": "arm"}
