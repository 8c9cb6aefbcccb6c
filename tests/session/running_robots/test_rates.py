"""How often something came, from hand-made moments; and what robots consist of."""

from __future__ import annotations

from io import StringIO

import pytest
from rich.console import Console

from poise.manage.control_socket.commands import RobotStatus
from poise.session.running_robots.local_robots import Rate, listing, names_of
from poise.wire.records.request_records import ManagerId


def test_a_rate_is_that_of_the_gaps_between() -> None:
    rate = Rate.of([0.0, 0.1, 0.2, 0.4])
    # gaps 0.1, 0.1, 0.2: mean 0.4 / 3, variance (2 x (1/30)^2 + (2/30)^2) / 3
    assert rate.mean == pytest.approx(7.5)
    assert (rate.shortest, rate.longest) == pytest.approx((0.1, 0.2))
    assert rate.jitter == pytest.approx(0.0471, abs=1e-4)
    (said,) = rate.lines()
    assert said == "7.5 Hz, 100 ms to 200 ms apart, jitter 47.1 ms (4 times)"


def test_what_came_once_has_no_rate() -> None:
    assert list(Rate.of([1.0]).lines()) == ["1 in this time: no rate"]


def test_what_came_before_begins_a_gap_and_is_not_counted_again() -> None:
    rate = Rate.of([1.2, 1.0], before=0.9)
    assert rate.count == 2
    assert rate.mean == pytest.approx(1 / 0.15)
    assert Rate.of([], before=0.9).count == 0


def test_what_is_missing_is_said() -> None:
    said = list(Rate.of([0.0, 1.0], missing=5).lines())
    assert said[1] == "5 more had no room to be noted: the rate is higher"


def test_topics_between_nodes_of_ros2_are_among_the_connectors() -> None:
    manager = ManagerId(key="k", user="ann", host="desk", pid=7, since=0.0)
    status = RobotStatus(
        robot="r",
        task="",
        manager=manager,
        placement={},
        computers={},
        by_ros2=("lidar-planner /scan",),
    )
    assert list(names_of({"r": status}, "connectors")) == ["lidar-planner /scan"]
    out = StringIO()
    for part in listing({"r": status}):
        Console(file=out, width=80).print(part)
    said = out.getvalue()
    assert "lidar-planner /scan" in said
    assert "ROS 2" in said
