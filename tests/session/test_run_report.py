"""What a run showed, worked out by hand."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from poise.manage.agent_connections.statuses import connectors_of
from poise.model.robot import Computer, Robot
from poise.session.run_records import (
    ComponentError,
    HungHandler,
    component_reports,
    cpu_shares,
)
from poise.session.run_report import RunReport
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ConnectorStatus,
    ContainerStatus,
    Fault,
    Summary,
)


def status(uptime: float, cpu: float, component_cpu: float) -> AgentStatus:
    return AgentStatus(
        computer="left",
        generation=1,
        uptime=uptime,
        cpu=cpu,
        containers=(
            ContainerStatus(
                name="eye",
                pid=1,
                components=(
                    ComponentStatus(name="grabber", state="active", cpu=component_cpu),
                ),
                connectors=(
                    ConnectorStatus(name="x", kind="local", end="source", ready=True),
                ),
            ),
        ),
    )


BEGIN, END = {"left": status(5.0, 2.0, 1.0)}, {"left": status(9.0, 4.0, 1.4)}


def test_cpu_is_a_share_of_what_the_computer_has() -> None:
    # 2 s in 4 s are half a core, of two cores that are half as fast
    left = Computer(name="left", capacity={"cpu": 2.0}, speed=0.5)
    robot = Robot(name="r", computers=(left,))
    assert cpu_shares(robot, BEGIN, END, {}) == {"left": 0.5}
    assert cpu_shares(robot, BEGIN, END, {"left": 2.0}) == {"left": 0.25}


def test_cpu_of_a_real_computer_is_a_share_of_its_own_cores() -> None:
    """Its cores are whole, however fast they are."""
    left = Computer(name="left", capacity={"cpu": 2.0}, speed=0.5, address="10.0.0.1")
    robot = Robot(name="r", computers=(left,))
    assert cpu_shares(robot, BEGIN, END, {}) == {"left": 0.25}


def test_a_computer_that_was_not_watched_has_no_share() -> None:
    robot = Robot(name="r", computers=(Computer(name="left", capacity={"cpu": 1.0}),))
    assert cpu_shares(robot, {}, END, {}) == {}
    assert cpu_shares(robot, END, END, {}) == {}


def test_a_components_cpu_is_of_the_run_alone() -> None:
    (report,) = component_reports(BEGIN, END, 4.0)
    assert (report.name, report.computer) == ("grabber", "left")
    assert report.cpu == pytest.approx(0.1)


def test_an_agent_that_was_started_again_changes_no_component_s_cpu() -> None:
    end = {"left": replace(END["left"], pid=7, uptime=0.5)}
    (report,) = component_reports(BEGIN, end, 4.0)
    assert report.cpu == pytest.approx(0.1)


def test_a_run_too_short_for_figures_of_computers_shows_components() -> None:
    report = replace(GOOD, components=component_reports(BEGIN, BEGIN, 0.1))
    assert "on left" in str(report)
    assert "grabber" in str(report)
    assert str(report).endswith("ran for 1.0 s")


def test_names_of_measures_are_no_markup() -> None:
    measures = {"age [ms]": Summary(count=1), "path [/x]": Summary(count=2)}
    (grabber,) = component_reports(BEGIN, END, 4.0)
    grabber = replace(grabber, measures=measures)
    report = replace(GOOD, components=(grabber,))
    for shown in str(report), report.page():
        assert "grabber age [ms]" in shown
        assert "grabber path [/x]" in shown


def test_every_end_of_a_connector_is_reported() -> None:
    assert [c.name for c in connectors_of(END)] == ["x"]


GOOD = RunReport(
    robot="r",
    task="work",
    method="static",
    placement={},
    decision_seconds=0.0,
    seconds=1.0,
    cpu_share={},
    components=(),
    connectors=(),
)
ERROR = ComponentError(
    component="eye", computer="left", where="tick", text="x", first=1.0, count=1
)
HUNG = HungHandler(component="eye", computer="left", handler="tick", seconds=2.0)


@pytest.mark.parametrize(
    "report",
    [
        replace(GOOD, errors=(ERROR,)),
        replace(GOOD, hung=(HUNG,)),
        replace(GOOD, refused={"eye.x-mind.x": 1}),
        replace(GOOD, faults=(Fault(container="eye", message="was killed"),)),
    ],
)
def test_a_run_fails_by_any_error(report: RunReport) -> None:
    assert not GOOD.failed
    assert report.failed
