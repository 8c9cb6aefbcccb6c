"""Ports that the robot file declares."""

from collections.abc import Callable

import pytest

from poise.errors import FileProblem

Find = Callable[[str], tuple[FileProblem, ...]]
Refuse = Callable[..., None]

ROBOT = """
robot: r
computers: {main: {cpu: 2, memory: 1}}
architectures:
  nav:
    function: f
    components:
      laser: {command: l, ports: {scan: {publishes: "m:Scan"}}}
      map: {command: m, ports: {scan: {subscribes: "m:Scan"}, walls: {provides: "m:W"}}}
      drive: {command: d, ports: {walls: {requires: "m:W"}, scan: {subscribes: "m:S"}}}
      free: {command: f}
    connectors: [CONNECTORS]
"""


@pytest.mark.parametrize(
    ("connectors", "words"),
    [
        (
            "{between: [▸laser.scam, map.scan]}",
            ["'laser' has no port 'scam'", "'scan'?", "'scan' (publishes m:Scan)"],
        ),
        ("{between: [laser.scan, ▸map]}", ["name the port of component 'map' too"]),
        (
            "{▸between: [map.scan, laser.scan]}",
            ["wrong way round", "[laser.scan, map.scan]"],
        ),
        ("{▸between: [map.scan, free]}", ["wrong way round", "[free, map.scan]"]),
        (
            "{▸between: [laser.scan, map.walls]}",
            ["'laser.scan' publishes and 'map.walls' provides", "does not fit"],
        ),
        (
            "{▸between: [laser.scan, drive.scan]}",
            ["the types differ", "publishes m:Scan", "subscribes m:S"],
        ),
        (
            "{between: [drive.walls, map.walls]}, {between: [▸drive.walls, free]}",
            ["'drive.walls' requires one provider", "drive.walls-free"],
        ),
    ],
)
def test_refuses_ends_that_do_not_fit(
    refuse: Refuse, connectors: str, words: list[str]
) -> None:
    refuse(ROBOT.replace("CONNECTORS", connectors), *words)


CHAIN = "chains: {c: {through: [THROUGH], deadline: 1 s}}\n"


def test_refuses_a_chain_against_the_way_of_messages(refuse: Refuse) -> None:
    robot = ROBOT.replace("CONNECTORS", "{between: [laser.scan, map.scan]}")
    chain = CHAIN.replace("THROUGH", "map, ▸laser")
    refuse(robot + chain, "messages go from 'laser' to 'map' only")


def test_a_chain_goes_with_messages_and_back_with_answers(find: Find) -> None:
    both = "{between: [laser.scan, map.scan]}, {between: [drive.walls, map.walls]}"
    chain = CHAIN.replace("THROUGH", "laser, map, drive")
    assert find(ROBOT.replace("CONNECTORS", both) + chain) == ()


def test_accepts_ends_that_fit(find: Find) -> None:
    connectors = (
        "{between: [laser.scan, map.scan]}, {between: [drive.walls, map.walls]}, "
        "{between: [laser.scan, free.anything]}"
    )
    assert find(ROBOT.replace("CONNECTORS", connectors)) == ()


ALTERNATIVES = """
robot: r
computers: {main: {cpu: 2, memory: 1}}
architectures:
  ends:
    function: e
    components: {drive: {command: d, ports: {walls: {requires: "m:W"}}}}
  first:
    function: f
    components:
      map: {command: m, ports: {walls: {provides: "m:W"}}}
      sketch: {command: s, ports: {walls: {provides: "m:W"}}}
  second:
    function: FUNCTION
    components: {plan: {command: p, ports: {walls: {provides: "m:W"}}}}
connectors: [CONNECTORS]
"""
TO_BOTH = "{between: [drive.walls, map.walls]}, {between: [▸drive.walls, plan.walls]}"


def test_a_required_port_may_be_joined_to_alternatives(
    find: Find, refuse: Refuse
) -> None:
    robot = ALTERNATIVES.replace("CONNECTORS", TO_BOTH)
    assert find(robot.replace("FUNCTION", "f").replace("▸", "")) == ()
    refuse(robot.replace("FUNCTION", "g"), "requires one provider", "same function")
    within = TO_BOTH.replace("plan.walls", "sketch.walls")
    robot = ALTERNATIVES.replace("FUNCTION", "f").replace("CONNECTORS", within)
    refuse(robot, "requires one provider", "drive.walls-sketch.walls")
