"""What of the next actions is prepared, within bounds."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from msgspec.structs import replace

from poise.manage.tasks.action_placement import LikelyAction
from poise.manage.tasks.prefetch import PrefetchPlan, choose
from poise.model.robot import Architecture, ComponentEntry, Computer, Device, Robot
from poise.model.steps import Prefetch

MB = 1 << 20
FREE = {"left": 0.2, "right": 0.2}


@pytest.fixture
def robot() -> Robot:
    """Return two computers of 100 MB, and components of 20 MB each; `map` has 40."""
    sizes = {"eyes": 20, "wheels": 20, "arm": 20, "mouth": 20, "map": 40}
    return Robot(
        name="r",
        computers=tuple(
            Computer(name=name, capacity={"cpu": 1.0, "memory": 100 * MB})
            for name in ("left", "right")
        ),
        devices=(Device(name="gripper", computer="left", exclusive=True),),
        architectures=tuple(
            Architecture(
                name=name,
                function=name,
                components=(ComponentEntry(name=name, demand={"memory": size * MB}),),
            )
            for name, size in sizes.items()
        ),
    )


def likely(probability: float, **placement: str) -> LikelyAction:
    return LikelyAction(
        what="+".join(placement),
        placement=placement,
        probability=probability,
    )


def chosen(
    robot: Robot,
    *actions: LikelyAction,
    running: Mapping[str, str] | None = None,
    cpu: Mapping[str, float] = FREE,
    held: Mapping[str, str] | None = None,
) -> PrefetchPlan:
    return choose(robot, running or {}, actions, cpu=cpu, held=held or {})


def test_what_is_next_is_prepared_where_it_will_run(robot: Robot) -> None:
    found = chosen(robot, likely(1, arm="left", mouth="right"))
    assert found.placement == {"arm": "left", "mouth": "right"}
    assert not found.why_not


def test_the_likelier_action_comes_first_and_a_smaller_one_uses_the_rest(
    robot: Robot,
) -> None:
    # 20 MB run: half of the other 80 MB may be used
    found = chosen(
        robot,
        likely(0.2, mouth="left"),
        likely(0.3, map="left"),
        likely(0.5, arm="left"),
        running={"eyes": "left"},
    )
    assert [*found.placement] == ["arm", "mouth"]
    assert found.why_not == {
        "map": "it needs 40 MiB of memory on 'left', where 20 MiB may be used for it"
    }


def test_an_action_is_prepared_whole_or_not_at_all(robot: Robot) -> None:
    found = chosen(
        robot,
        likely(1, arm="left", map="right"),
        running={"eyes": "right", "wheels": "right"},  # 30 MB may be used
    )
    assert not found.placement


def test_what_several_actions_need_counts_once(robot: Robot) -> None:
    found = chosen(
        robot, likely(0.5, arm="left", mouth="left"), likely(0.5, arm="left")
    )
    assert found.placement == {"arm": "left", "mouth": "left"}


def test_the_bound_of_memory_is_the_users(robot: Robot) -> None:
    most = replace(robot, prefetch=Prefetch(memory=0.1))
    assert not chosen(most, likely(1, arm="left")).placement


def test_what_rests_is_dropped_first(robot: Robot) -> None:
    held = {"wheels": "left", "mouth": "left"}
    assert chosen(robot, held=held).placement == held
    # 50 MB may be used: 40 for the map, which leaves no room for them
    assert chosen(robot, likely(0.1, map="left"), held=held).placement == {
        "map": "left"
    }


def test_what_is_prepared_makes_room_for_what_runs(robot: Robot) -> None:
    held = {"arm": "left"}
    running = {"eyes": "left", "map": "left", "wheels": "left"}  # leaves 20 MB
    found = chosen(robot, likely(1, arm="left"), running=running, held=held)
    assert not found.placement


def test_nothing_begins_where_no_cpu_is_left_but_what_is_ready_stays(
    robot: Robot,
) -> None:
    cpu = {"left": 0.001, "right": 0.2}
    found = chosen(robot, likely(1, arm="left"), cpu=cpu)
    assert found.why_not == {
        "arm": "the running components leave no CPU free on 'left'"
    }
    found = chosen(robot, likely(1, arm="left"), cpu=cpu, held={"arm": "left"})
    assert found.placement == {"arm": "left"}


def test_nothing_is_prepared_on_a_computer_that_is_out_of_reach(robot: Robot) -> None:
    found = chosen(robot, likely(1, arm="left"), cpu={"right": 0.2})
    assert found.why_not == {"arm": "computer 'left' is out of reach"}


def test_what_uses_an_exclusive_device_that_is_in_use_waits(robot: Robot) -> None:
    holds = robot.with_components(
        lambda c: replace(c, devices=("gripper",)) if c.name in {"arm", "eyes"} else c
    )
    wanted = likely(1, arm="left", mouth="left")
    found = chosen(holds, wanted, running={"eyes": "left"})
    assert found.placement == {"mouth": "left"}
    assert chosen(holds, wanted).placement == {"arm": "left", "mouth": "left"}
