"""What a class declares, and what it must not."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any, Protocol

import pytest

from poise import (
    Component,
    Message,
    Provided,
    Published,
    Required,
    every,
    found,
    lost,
    oneway,
    subscribed,
)
from poise.errors import UsageError
from poise.runtime.component.ports import (
    Port,
    Queue,
    Timer,
    is_oneway,
    methods_of,
    ports_of,
    timers_of,
)
from poise.runtime.connectors.interface import methods
from poise.runtime.hosting import cpp_component


class Pose(Message):
    x: float


@dataclass
class Gains:
    gain: float


class Marks(Protocol):
    def mark(self, pose: Pose) -> None: ...


class Walls(Protocol):
    def near(self, pose: Pose, limit: float = 1.0) -> int: ...

    @oneway
    def forget(self) -> None: ...


class Everything(Component):
    mine: Provided[Walls]
    theirs: Required[Walls]
    pose: Published[Pose]

    def near(self, pose: Pose, limit: float = 1.0) -> int:
        return round(pose.x + limit)

    def forget(self) -> None: ...

    @subscribed(keep=3)
    def target(self, message: Pose) -> None: ...

    @subscribed("goal", block=2)
    def on_goal(self, message: Pose) -> None: ...

    @every(0.1, deadline=0.05)
    def cycle(self) -> None: ...

    @every(hz=50)
    def steer(self) -> None: ...


def test_finds_every_port() -> None:
    assert ports_of(Everything) == {
        "mine": Port("mine", "provides", Walls),
        "theirs": Port("theirs", "requires", Walls),
        "pose": Port("pose", "publishes", Pose),
        "target": Port("target", "subscribes", Pose, Queue("keep", 3), "target"),
        "goal": Port("goal", "subscribes", Pose, Queue("block", 2), "on_goal"),
    }


def test_ports_are_inherited() -> None:
    class More(Everything):
        extra: Published[Pose]

    assert ports_of(More).keys() == ports_of(Everything).keys() | {"extra"}


def test_finds_every_timer() -> None:
    assert timers_of(Everything) == {
        "cycle": Timer("cycle", 0.1, 0.05),
        "steer": Timer("steer", 0.02),
    }


def test_knows_an_interfaces_methods() -> None:
    assert set(methods_of(Walls)) == {"near", "forget"}
    assert is_oneway(Walls, "forget")
    assert not is_oneway(Walls, "near")


def test_binds_arguments_however_they_are_given() -> None:
    (near,) = [m for m in methods(Walls).values() if m.name == "near"]
    assert near.bind(Pose(1.0)) == (Pose(1.0), 1.0)
    assert near.bind(limit=2.0, pose=Pose(1.0)) == (Pose(1.0), 2.0)
    with pytest.raises(TypeError):
        near.bind()


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"period": 0}, "every(0): period must"),
        ({"period": -1}, "every(-1): period must"),
        ({"period": math.nan}, "every(nan): period must"),
        ({"hz": 0}, "every(hz=0): hz must"),
        ({"period": 1, "deadline": 0}, "every(1, deadline=0): deadline must"),
    ],
)
def test_a_timer_needs_times_above_zero(given: dict[str, float], why: str) -> None:
    """What was not given was said to be None, and to be above 0."""
    with pytest.raises(UsageError, match=f"^{re.escape(why)} be above 0$"):
        every(**given)


@pytest.mark.parametrize(
    "given",
    [{"period": math.inf}, {"hz": math.inf}, {"hz": 1e-300}, {"period": 1e-300}],
)
def test_a_timer_has_a_period_that_a_clock_can_count(given: dict[str, float]) -> None:
    with pytest.raises(UsageError, match="from 1e-09 to 1e\\+09 s"):
        every(**given)


@pytest.mark.parametrize(
    "given", [{"period": "0.1"}, {"hz": "10"}, {"period": 1, "deadline": [1]}]
)
def test_a_timer_takes_its_times_as_numbers(given: Any) -> None:
    with pytest.raises(UsageError, match="seconds as a number, as in @every"):
        every(**given)


def test_a_timer_has_a_period_or_a_rate() -> None:
    for wrong in ({}, {"period": 0.1, "hz": 10}):
        with pytest.raises(UsageError, match=r"give either, as in @every\(0.1\)"):
            every(**wrong)


def test_two_handlers_are_no_one_port() -> None:
    class Double(Component):
        @subscribed("scan", keep=1)
        def first(self, message: Pose) -> None: ...

        @subscribed("scan", keep=1)
        def second(self, message: Pose) -> None: ...

    with pytest.raises(UsageError, match=r"two ports are named 'scan'.*'second'"):
        ports_of(Double)


def test_a_port_is_named_as_python_names_things() -> None:
    with pytest.raises(
        UsageError, match="a port's name must be an identifier, such as 'scan'"
    ):
        subscribed("front scan")


@pytest.mark.parametrize(
    ("queue", "says"),
    [
        ({"keep": 1, "block": 1}, "not both"),
        ({"keep": 0, "block": 1}, "not both"),
        ({"keep": 0}, r"subscribed\(keep=0\): a queue holds at least 1"),
        ({"block": -2}, r"subscribed\(block=-2\): a queue holds at least 1"),
    ],
)
def test_a_queue_is_of_one_policy_and_holds_something(
    queue: dict[str, int], says: str
) -> None:
    with pytest.raises(UsageError, match=says):
        subscribed(**queue)


def test_what_needs_parentheses_says_so() -> None:
    def tick() -> None: ...

    with pytest.raises(UsageError, match=r"as in @every\(0.1\)"):
        every(tick)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match=r"as in @subscribed\(keep=1\)"):
        subscribed(tick)  # type: ignore[arg-type]


def test_a_subscriber_says_the_type_of_its_message() -> None:
    class Mute(Component):
        @subscribed()
        def scan(self, message) -> None: ...  # type: ignore[no-untyped-def]  # noqa: ANN001

    with pytest.raises(
        UsageError, match=r"scan: a subscribed method takes one message"
    ):
        ports_of(Mute)


def test_a_provided_interface_is_implemented() -> None:
    class Half(Component):
        walls: Provided[Walls]

        def forget(self) -> None: ...

    with pytest.raises(UsageError, match=r"Half provides walls: Walls, but .* near"):
        ports_of(Half)


def test_a_parameter_needs_a_type_and_a_place() -> None:
    class Loose(Protocol):
        def call(self, *numbers: int) -> None: ...

    class Named(Protocol):
        def call(self, *, number: int) -> None: ...

    class Untyped(Protocol):
        def call(self, number) -> Any: ...  # type: ignore[no-untyped-def]  # noqa: ANN001

    for interface in (Loose, Named, Untyped):
        with pytest.raises(UsageError, match="needs a type and a place of its own"):
            methods(interface)


def test_what_poise_calls_is_no_coroutine() -> None:
    class Timed(Component):
        @every(1.0)
        async def tick(self) -> None: ...

    class Hooked(Component):
        async def configure(self) -> None: ...  # type: ignore[override]

    class Served(Component):
        marks: Provided[Marks]

        async def mark(self, pose: Pose) -> None: ...

    class Own(Component):
        async def mine(self) -> None: ...

    for class_, name in ((Timed, "tick"), (Hooked, "configure"), (Served, "mark")):
        with pytest.raises(UsageError, match=rf"{name}: .*without `async`"):
            ports_of(class_)
    assert ports_of(Own) == {}


class Loose(Component):
    """Takes what Poise calls it with in ways of its own."""

    walls: Provided[Walls]

    def __init__(self, speed: float = 1.0, *_: float) -> None: ...

    @staticmethod
    def near(where: Pose, most: float) -> float: ...  # type: ignore[empty-body]

    @classmethod
    def forget(cls, *_: object) -> None: ...

    def restore(self, state: Pose, *, quickly: bool = False) -> None: ...

    def begin(self, *actions: str) -> None: ...

    @staticmethod
    @every(1.0)
    def tick(*_: object, **__: object) -> None: ...


def test_a_method_that_can_be_called_may_take_more() -> None:
    assert list(ports_of(Loose)) == ["walls"]
    assert list(timers_of(Loose)) == ["tick"]


def test_a_method_in_cpp_takes_what_its_instance_does() -> None:
    """Its class in Python says nothing of a hook's argument but its type."""
    maps: dict[str, Any] = {"published": {}, "required": {}, "provided": {}}
    lists: dict[str, Any] = {"latest": [], "subscribed": [], "timers": []}
    hooks = dict.fromkeys(("configure", "begin", "reconfigure"))
    declared = {**maps, **lists, "hooks": hooks}
    class_ = cpp_component.component(
        "InCpp", "parts", declared, lambda _: ({}, print, 0)
    )
    assert ports_of(class_) == {}


def test_what_poise_calls_takes_what_it_gives() -> None:
    class Built(Component):
        def __init__(self, speed: float) -> None: ...

    class Hooked(Component):
        def snapshot(self, all_of_it: bool) -> None: ...  # type: ignore[override]  # noqa: FBT001

    class Restored(Component):
        def restore(self) -> None: ...  # type: ignore[override]

    class Timed(Component):
        @every(1.0)
        def tick(self, now: float) -> None: ...

    class Selfless(Component):
        @every(1.0)
        def tick() -> None: ...  # type: ignore[misc]

    class Watching(Component):
        @subscribed()
        def scan(self, message: Pose) -> None: ...

        @lost("scan")
        def brake(self, port: str) -> None: ...

    for class_, method in (
        (Built, "__init__(self)"),
        (Hooked, "snapshot(self)"),
        (Restored, "restore(self, state)"),
        (Timed, "tick(self)"),
        (Selfless, "tick(self)"),
        (Watching, "brake(self)"),
    ):
        with pytest.raises(UsageError, match=re.escape(f"write `def {method}`")):
            ports_of(class_)


def test_a_provided_method_takes_what_its_interface_says() -> None:
    class Few(Loose):
        def near(self, pose: Pose) -> float: ...  # type: ignore[override, empty-body]

    class Many(Loose):
        def forget(self, pose: Pose, why: str) -> None: ...  # type: ignore[override]

    for class_, method in ((Few, "near(self, pose, limit)"), (Many, "forget(self)")):
        with pytest.raises(UsageError, match=re.escape(f"write `def {method}`")):
            ports_of(class_)


def test_the_type_of_a_port_is_not_assigned() -> None:
    class Assigned(Component):
        pose = Published[Pose]

    with pytest.raises(UsageError, match=r"pose is no port: write a colon"):
        ports_of(Assigned)


@pytest.mark.parametrize("kind", ["Published", "Provided", "Required"])
def test_a_port_says_its_type(kind: str) -> None:
    """`poise check` said that the component had no such port."""
    hint = {"Published": Published, "Provided": Provided, "Required": Required}[kind]
    bare = type("Bare", (Component,), {"__annotations__": {"pose": hint}})
    with pytest.raises(UsageError, match=rf"Bare.pose .*`pose: {kind}\[Type\]`"):
        ports_of(bare)


def test_parameters_have_a_type_that_values_are_checked_against() -> None:
    class Pilot(Component):
        parameters: Gains

    class Plain(Component):
        parameters: dict[str, float]

    with pytest.raises(UsageError, match=r"Pilot: `parameters: .*Gains` declares noth"):
        ports_of(Pilot)
    assert ports_of(Plain) == {}


def test_only_a_subscribed_port_can_be_lost() -> None:
    class Wrong(Component):
        @subscribed(keep=1)
        def scan(self, message: Pose) -> None: ...

        @lost("scam")
        def brake(self) -> None: ...

    with pytest.raises(UsageError, match=r"no subscribed port .did you mean 'scan'"):
        ports_of(Wrong)
    with pytest.raises(UsageError, match=r"@found takes a port's name"):
        found("no port")


def test_a_class_hides_nothing_that_every_component_has() -> None:
    class Port(Component):
        log: Published[int]  # type: ignore[assignment]

    class Method(Component):
        def measure(self) -> None:  # type: ignore[override]
            """Take no name."""

    for component, name in ((Port, "log"), (Method, "measure")):
        with pytest.raises(UsageError, match=f"{name}: each component has a '{name}'"):
            ports_of(component)
