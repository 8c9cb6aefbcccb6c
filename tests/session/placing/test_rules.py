"""Placements by a rule or from a file."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest
from msgspec.structs import replace

import poise
from poise.errors import UsageError
from poise.model.robot import Architecture, ComponentEntry, Computer, Robot

NAMES = ("a", "b", "c", "d", "held")


@pytest.fixture
def robot() -> Robot:
    """Return two computers and five components; the last may run on `right` only."""
    free = [ComponentEntry(name=name, demand={"cpu": 0.1}) for name in NAMES[:-1]]
    held = ComponentEntry(name="held", demand={"cpu": 0.1}, only=("right",))
    return Robot(
        name="ruled",
        computers=tuple(
            Computer(name=name, capacity={"cpu": 1.0}) for name in ("left", "right")
        ),
        architectures=(
            Architecture(
                name="all", function="all", home="left", components=(*free, held)
            ),
        ),
    )


def test_round_robin_deals_components_in_turn(robot: Robot) -> None:
    placed = poise.place(robot, method="round-robin")
    assert placed.where == {
        "a": "left",
        "b": "right",
        "c": "left",
        "d": "right",
        "held": "right",
    }
    assert placed.method == "round-robin"


def test_whole_functions_share_a_computer_but_for_devices() -> None:
    """The larger function comes first; of the second, one component has no choice."""

    def function(name: str, **cpu: float) -> Architecture:
        components = tuple(
            ComponentEntry(
                name=each,
                demand={"cpu": share},
                only=("left",) if each.startswith("held") else (),
            )
            for each, share in cpu.items()
        )
        return Architecture(
            name=name, function=name, home="left", components=components
        )

    robot = Robot(
        name="ruled",
        computers=tuple(
            Computer(name=name, capacity={"cpu": 1.0}) for name in ("left", "right")
        ),
        architectures=(
            function("small", a=0.1, held=0.1),
            function("large", b=0.3, c=0.3),
        ),
    )
    where = poise.place(robot, method="whole-functions").where
    assert where == {"a": "right", "held": "left", "b": "left", "c": "left"}


def test_a_random_placement_is_the_same_for_the_same_seed(robot: Robot) -> None:
    found = [poise.place(robot, method=f"random:{n}").where for n in (*range(9), 0)]
    assert found[0] == found[-1]
    assert len({tuple(each.items()) for each in found}) > 1
    assert {each["held"] for each in found} == {"right"}


def test_a_placement_is_read_from_what_plan_printed(
    robot: Robot, tmp_path: Path
) -> None:
    wanted = dict.fromkeys(NAMES, "right")
    for name, content in (
        ("plain.yaml", "".join(f"{n}: right\n" for n in NAMES)),
        ("printed.json", json.dumps({"placement": wanted, "feasible": True})),
    ):
        (tmp_path / name).write_text(content)
        placed = poise.place(robot, method=str(tmp_path / name))
        assert placed.where == wanted


def test_a_file_may_have_names_that_are_truth_values_elsewhere(tmp_path: Path) -> None:
    sees = Architecture(
        name="sees",
        function="seeing",
        home="yes",
        components=tuple(ComponentEntry(name=name) for name in ("on", "no")),
    )
    computers = tuple(Computer(name=n, capacity={"cpu": 1.0}) for n in ("yes", "off"))
    robot = Robot(name="r", computers=computers, architectures=(sees,))
    file = tmp_path / "placement.yaml"
    file.write_text("on: off\nno: yes\n")
    where = poise.place(robot, method=str(file)).where
    assert where == {"on": "off", "no": "yes"}


def test_a_file_with_a_number_that_is_none_is_refused(
    robot: Robot, tmp_path: Path
) -> None:
    file = tmp_path / "placement.yaml"
    file.write_text("a: left\n!!int x: left\n")
    with pytest.raises(UsageError, match="cannot be read: invalid literal"):
        poise.place(robot, method=str(file))


def test_a_file_that_places_a_component_twice_is_refused(
    robot: Robot, tmp_path: Path
) -> None:
    file = tmp_path / "placement.yaml"
    file.write_text("a: left\nb: left\na: right\n")
    with pytest.raises(UsageError, match="cannot be read: 'a' is there 2 times"):
        poise.place(robot, method=str(file))


def test_all_that_is_wrong_with_a_file_is_said_at_once(
    robot: Robot, tmp_path: Path
) -> None:
    file = tmp_path / "placement.yaml"
    file.write_text("a: left\nb: nowhere\nc: left\nheld: left\nother: left\n")
    with pytest.raises(UsageError) as said:
        poise.place(robot, method=str(file))
    assert str(said.value) == (
        f"placement {file}: 'b' may not run on 'nowhere', "
        "only on left or right; 'held' may not run on 'left', only on right; the task "
        "needs no component 'other'"
    )


@pytest.mark.parametrize(
    ("rule", "said"),
    [
        ("random:x", "the seed is a whole number, as in random:7"),
        ("nowhere.yaml", "nowhere.yaml cannot be read: No such file or directory$"),
        ("fast", "no method 'fast'"),
    ],
)
def test_a_rule_that_is_none_is_refused(robot: Robot, rule: str, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        poise.place(robot, method=rule)


def test_a_rule_may_overfill_a_computer_and_says_so(robot: Robot) -> None:
    small = replace(
        robot,
        computers=tuple(replace(c, capacity={"cpu": 0.2}) for c in robot.computers),
    )
    placed = poise.place(small, method="round-robin")
    assert not placed.feasible
    assert "right: cpu needs 0.3" in placed.reason


def test_a_file_may_place_another_alternative(robot: Robot, tmp_path: Path) -> None:
    (first,) = robot.architectures
    lesser = Architecture(
        name="lesser",
        function="all",
        home="left",
        quality=0.5,
        components=(ComponentEntry(name="only_one", demand={"cpu": 0.1}),),
    )
    both = replace(robot, architectures=(first, lesser))
    (tmp_path / "placement.yaml").write_text("only_one: right\n")
    placed = poise.place(both, method=str(tmp_path / "placement.yaml"))
    assert placed.where == {"only_one": "right"}


def test_a_rule_may_split_what_is_together_and_says_so(robot: Robot) -> None:
    placed = poise.place(replace(robot, together=(("a", "b"),)), method="round-robin")
    assert not placed.feasible
    assert placed.where["a"] != placed.where["b"]
    assert "a, b must share a computer: a is on left, b is on right" in placed.reason


@pytest.fixture
def tight(robot: Robot) -> Robot:
    """Return the robot with one more function that fits nowhere."""
    large = Architecture(
        name="large",
        function="more",
        priority=-1,
        components=tuple(
            ComponentEntry(name=name, demand={"cpu": 0.9}) for name in ("x", "y")
        ),
    )
    return replace(robot, architectures=(*robot.architectures, large))


def test_what_plan_has_suspended_stays_suspended(tight: Robot, tmp_path: Path) -> None:
    planned = poise.place(tight, fewer=True)
    assert planned.result.suspended == ("large",)
    printed, plain = tmp_path / "printed.json", tmp_path / "plain.yaml"
    printed.write_bytes(msgspec.json.encode(planned.result.to_dict()))
    nulls = {**planned.where, "x": None, "y": None}
    plain.write_bytes(msgspec.yaml.encode(nulls))
    for file in (printed, plain):
        placed = poise.place(tight, method=str(file))
        assert placed.feasible
        assert placed.where == planned.where
        assert placed.result.suspended == ("large",)
        assert placed.why_suspended == (
            f"not all fits: placement {file} suspends large"
        )


@pytest.mark.parametrize(
    ("more", "lacks"),
    [({}, "x, y"), ({"x": None}, "x, y"), ({"x": "left", "y": None}, "y")],
)
def test_a_file_must_have_what_it_does_not_suspend(
    tight: Robot, tmp_path: Path, more: dict[str, str | None], lacks: str
) -> None:
    file = tmp_path / "placement.json"
    file.write_text(json.dumps({**dict.fromkeys(NAMES, "right"), **more}))
    with pytest.raises(UsageError, match=f"placement.json lacks {lacks}: "):
        poise.place(tight, method=str(file))


def test_a_layer_below_may_not_be_suspended(tight: Robot, tmp_path: Path) -> None:
    task, large = tight.architectures
    reactive = replace(large, layer="reactive", home="left")
    file = tmp_path / "placement.json"
    nulls = {"x": None, "y": None}
    file.write_text(json.dumps({**dict.fromkeys(NAMES, "right"), **nulls}))
    with pytest.raises(UsageError, match="lacks x, y: "):
        poise.place(replace(tight, architectures=(task, reactive)), method=str(file))


def test_an_architecture_without_components_is_not_suspended(
    tight: Robot, tmp_path: Path
) -> None:
    """It is on no computer, but the file puts nothing of it on null either."""
    magnet = Architecture(name="magnet", function="grasp", home="left")
    robot = replace(tight, architectures=(*tight.architectures, magnet))
    file = tmp_path / "placement.yaml"
    where = {
        n: "right" for a in tight.architectures for n in [c.name for c in a.components]
    }
    file.write_text(json.dumps(where))
    assert not poise.place(robot, method=str(file)).result.suspended


@pytest.mark.parametrize(
    ("suspended", "said"),
    [
        (["al"], "there is no architecture 'al' .did you mean 'all'"),
        ("all", "'suspended' is no list of architectures"),
    ],
)
def test_a_file_suspends_only_architectures_that_are_there(
    robot: Robot, tmp_path: Path, suspended: object, said: str
) -> None:
    """Else a misspelt one would run, or be said to lack components."""
    file = tmp_path / "placement.json"
    file.write_text(json.dumps({"placement": {}, "suspended": suspended}))
    with pytest.raises(UsageError, match=said):
        poise.place(robot, method=str(file))
