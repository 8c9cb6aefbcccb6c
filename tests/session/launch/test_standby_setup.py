"""A real robot without standbys says so, and what would give it some."""

from __future__ import annotations

from poise.model.robot import Computer, Robot
from poise.session.launch.managed import without_standbys


def robot(*addresses: str | None, manager: tuple[str, ...] | None = None) -> Robot:
    computers = tuple(
        Computer(name=name, capacity={"cpu": 1.0}, address=address)
        for name, address in zip("abc", addresses, strict=False)
    )
    return Robot(name="hello", computers=computers, manager=manager)


def test_three_real_computers_have_standbys_unless_the_file_says_none() -> None:
    addresses = "10.0.0.1", "10.0.0.2", "10.0.0.3"
    assert robot(*addresses).standbys == ("a", "b", "c")
    assert robot(*addresses, manager=("b",)).standbys == ("b",)
    assert robot(*addresses, manager=()).standbys == ()
    assert robot(None, None, None).standbys == ()


def test_a_real_robot_of_several_computers_says_that_it_has_none() -> None:
    assert "witness" in without_standbys(robot("10.0.0.1", "10.0.0.2"))
    assert "`manager`" in without_standbys(robot("10.0.0.1", "10.0.0.2", manager=()))


def test_others_say_nothing() -> None:
    assert not without_standbys(robot("10.0.0.1", "10.0.0.2", manager=("a", "b")))
    assert not without_standbys(robot("10.0.0.1"))
    assert not without_standbys(robot(None, None))
