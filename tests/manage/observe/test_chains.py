"""How old a chain's data is, seen over time: scanner -> localiser -> controller."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from poise.manage.observe.chains import ChainAges, ChainReport, chain_reports
from poise.model.robot import Chain, Connector, ConnectorEnd, Robot
from poise.wire.records.status_records import (
    AgentStatus,
    ChainStatus,
    ComponentStatus,
    ConnectorStatus,
    ContainerStatus,
    Summary,
)

ROBOT = Robot(
    name="r",
    connectors=(
        Connector(
            between=(ConnectorEnd("scanner", "scan"), ConnectorEnd("localiser", "scan"))
        ),
        Connector(
            between=(
                ConnectorEnd("controller", "poses"),
                ConnectorEnd("localiser", "poses"),
            )
        ),
    ),
    chains=(
        Chain(
            name="pose", through=("scanner", "localiser", "controller"), deadline=0.2
        ),
    ),
)
SCANS, POSES = "scanner.scan-localiser.scan", "controller.poses-localiser.poses"


def statuses(
    used: int, missed: int, within: float = 0.1, last: float = 0.3
) -> dict[str, AgentStatus]:
    """Return what the agents say of the chain; the scanner is on another computer."""

    def agent(
        name: str,
        ages: Mapping[str, tuple[float, int] | None],
        *ends: ConnectorStatus,
    ) -> AgentStatus:
        components = tuple(
            ComponentStatus(
                name=component,
                state="active",
                chains=()
                if age is None
                else (
                    ChainStatus(
                        name="pose",
                        age=Summary(count=used, mean=age[0], median=age[0]),
                        missed=age[1],
                    ),
                ),
            )
            for component, age in ages.items()
        )
        container = ContainerStatus(
            name="c", pid=1, components=components, connectors=ends
        )
        return AgentStatus(
            computer=name, generation=1, uptime=1.0, cpu=0.0, containers=(container,)
        )

    came = ConnectorStatus(
        name=SCANS, kind="remote", end="target", ready=True, latency_error=0.001
    )
    asks = ConnectorStatus(name=POSES, kind="direct", end="both", ready=True)
    return {
        "head": agent("head", {"scanner": None}),
        "body": agent(
            "body", {"localiser": (within, 0), "controller": (last, missed)}, came, asks
        ),
    }


def report(used: int, missed: int, **ages: float) -> ChainReport:
    (found,) = chain_reports(ROBOT, statuses(used, missed, **ages))
    return found


def test_a_report_has_every_component_and_the_clocks_error() -> None:
    found = report(10, 3)
    assert [(hop.component, hop.computer, hop.age.mean) for hop in found.hops] == [
        ("scanner", "head", 0.0),
        ("localiser", "body", 0.1),
        ("controller", "body", 0.3),
    ]
    assert (found.deadline, found.missed, found.error) == (0.2, 3, 0.001)


def test_a_chain_that_does_not_run_as_a_whole_is_not_reported() -> None:
    assert chain_reports(ROBOT, {"body": statuses(1, 0)["body"]}) == ()


def test_only_what_was_used_lately_counts() -> None:
    ages = ChainAges()
    ages.measure([report(100, 0, within=0.01, last=0.02)], 0.0)
    # ten uses more: 100 at 0.02 s and these at 0.24 s are 0.04 s in the mean
    mean = (100 * 0.02 + 10 * 0.24) / 110
    (found,) = ages.measure([report(110, 9, within=0.01, last=mean)], 1.0)
    assert (found.used, found.missed) == (10, 9)
    assert found.is_late
    assert found.ages["controller"] == pytest.approx(0.24)
    assert found.slowest == "controller"
    assert str(found) == "scanner -> localiser 10 ms, localiser -> controller 230 ms"
    (found,) = ages.measure([report(120, 9, within=0.01, last=mean)], 2.0)
    assert not found.is_late


def test_what_is_used_no_more_is_forgotten() -> None:
    ages = ChainAges()
    ages.measure([report(1, 1)], 0.0)
    assert ages.measure([report(2, 2)], 1.0)[0].is_late
    for second in range(2, 12):
        found = ages.measure([report(2, 2)], float(second))
    assert found == ()
