"""What the page shows, and what of it is sent."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from poise.manage.journal import JournalEntry
from poise.manage.observe.chains import ChainHop, ChainReport
from poise.manage.observe.deviations import Deviation
from poise.session.running_robots.running import Status
from poise.view.dashboard.state import (
    Page,
    PageState,
    RecentHistory,
    Updates,
    changes,
    why,
)
from poise.view.robot_view import LiveReading
from poise.wire.records.request_records import ManagerId
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ConnectorStatus,
    ContainerStatus,
    Summary,
    TimerStatus,
)


def seen(
    missed: int = 0, releases: int = 10, computer: str = "left", at: float = 1.0
) -> LiveReading:
    timer = TimerStatus(
        name="tick",
        period=0.1,
        deadline=0.1,
        releases=releases,
        missed=missed,
        lateness=Summary(),
        duration=Summary(),
    )
    container = ContainerStatus(
        name="all",
        pid=1,
        at=at,
        components=(ComponentStatus(name="arm", state="active", timers=(timer,)),),
        connectors=(
            ConnectorStatus(
                name="arm.out-lid-2.in", kind="remote", end="source", ready=True
            ),
        ),
    )
    agent = AgentStatus(
        computer=computer, generation=1, uptime=9.0, cpu=1.0, containers=(container,)
    )
    other = "right" if computer == "left" else "left"
    empty = AgentStatus(computer=other, generation=1, uptime=9.0, cpu=0.0)
    status = Status(
        robot="r",
        task="work",
        manager=ManagerId(key="k", user="ann", host="desk", pid=7, since=0.0),
        placement={"arm": computer, "lid-2": "right"},
        computers={computer: agent, other: empty},
    )
    return LiveReading(status=status)


def test_every_component_is_on_its_computer() -> None:
    page = PageState().of(seen(), 0.0)
    assert {name: each["at"] for name, each in page["components"].items()} == {
        "arm": "left",
        "lid-2": "right",
    }
    assert page["components"]["lid-2"]["state"] == "not there"
    assert set(page["computers"]) == {"left", "right"}
    (connector,) = page["connectors"].values()
    assert (connector["source"], connector["target"]) == ("arm", "lid-2")


def test_only_late_deadlines_of_the_last_seconds_count_as_late_now() -> None:
    state = PageState()
    state.of(seen(missed=5, releases=10, at=1.0), 0.0)
    page = state.of(seen(missed=5, releases=20, at=3.0), 2.0)
    assert page["timers"]["arm.tick"]["now"] == 0.0
    assert "late" not in page["components"]["arm"]
    page = state.of(seen(missed=10, releases=30, at=5.0), 4.0)
    assert page["timers"]["arm.tick"]["now"] == pytest.approx(0.25)
    assert page["components"]["arm"]["late"] == pytest.approx(0.25)


def test_a_component_that_is_being_ended_is_no_longer_placed() -> None:
    known = seen(missed=5)
    assert known.status is not None
    gone = replace(known, status=replace(known.status, placement={"lid-2": "right"}))
    assert "arm" not in PageState().of(gone, 0.0)["components"]


def test_only_what_has_changed_is_sent() -> None:
    state = PageState()
    before, same = state.of(seen(), 0.0), state.of(seen(), 0.0)
    assert not changes(before, before)
    assert changes({}, before) == {part: r for part, r in before.items() if r}
    status = seen(computer="right").status
    assert status is not None
    right = {"right": status.computers["right"]}
    after = state.of(LiveReading(status=replace(status, computers=right)), 1.0)
    differ = changes(same, after)
    assert differ["components"]["arm"]["at"] == "right"
    assert "lid-2" not in differ["components"]
    assert differ["computers"]["left"] is None


def test_a_page_gets_the_latest_when_it_took_the_last_update() -> None:
    updates, wholes = Updates(), []
    assert updates.next({"robot": {"": {"at": 1}}}, 10.0) == {"robot": {"": {"at": 1}}}
    wholes.append(updates.is_whole)
    assert updates.next({"robot": {"": {"at": 2}}}, 10.2) is None  # it may queue
    updates.note_taken()
    page = {"robot": {"": {"at": 3}}}
    assert updates.next(page, 10.4) == {"robot": {"": {"at": 3}}}
    wholes.append(updates.is_whole)
    updates.note_taken()
    assert updates.next(dict(page), 10.6) is None  # nothing is new
    assert updates.next(page, 12.0) is None  # and nothing was read
    assert updates.next(dict(page), 12.0) == {}
    updates.begin_anew()
    assert updates.next(page, 12.2) == page
    wholes.append(updates.is_whole)
    assert wholes == [True, False, True]


def test_a_robot_that_gives_no_answer_is_shown_as_it_was() -> None:
    known = seen()
    gone = LiveReading(status=known.status, trouble="no answer", since=5.0)
    page = PageState().of(gone, 0.0)
    assert page["robot"][""]["trouble"] == "no answer"
    assert "arm" in page["components"]
    assert "components" not in PageState().of(LiveReading(trouble="none runs"), 0.0)


def test_what_agents_report_is_not_old_and_says_nothing_of_needs() -> None:
    known = seen()
    assert known.status is not None
    why = Deviation(what="no manager", computer="", since=5.0)
    status = replace(known.status, by_agents=True, deviations=(why,))
    reading = LiveReading(status=status, trouble="no manager", since=5.0)
    page = PageState().of(reading, 0.0)
    assert page["robot"][""]["deviations"] == []  # it is said already
    assert not page["robot"][""]["old"]
    stopped = replace(reading, is_old=True, trouble="it does not run here")
    shown = PageState().of(stopped, 0.0)["robot"][""]
    assert shown["old"]
    assert shown["deviations"] == []  # nor does it run without a manager
    assert page["computers"]["left"]["need"] is None
    idle = replace(status, placement={"arm": "left"})
    page = PageState().of(replace(reading, status=idle), 0.0)
    assert page["computers"]["right"]["need"] == 0.0


def test_a_decision_says_what_its_policy_saw_and_what_it_gains() -> None:
    terms = {"total": 0.5, "communication": 0.5, "balance": 0.0, "move": 0.0}
    facts = {
        "policies": [{"policy": "overload", "saw": {"name": "left", "share": 0.98765}}],
        "decision": {
            "proposal": {"now": terms, "then": {**terms, "total": 0.25}},
            "gain": 6.0,
            "cost": 0.31,
            "acts": True,
        },
    }
    assert why(JournalEntry(0.0, "decided", "1 step", facts)) == (
        "Policy 'overload' saw of 'left': share 0.988. "
        "The change costs 0.31 core-seconds of work and gains 6.00: it was done."
    )
    assert not why(JournalEntry(0.0, "seen", "something", {}))


def test_nothing_of_a_computer_that_is_silent_counts_as_fine_or_live() -> None:
    state = PageState()
    state.of(seen(missed=0, releases=10, at=1.0), 0.0)
    known = seen(missed=0, releases=20, at=2.0)
    assert known.status is not None
    silent = replace(known, status=replace(known.status, ages={"left": 12.4}))
    page = state.of(silent, 1.0)
    assert page["timers"]["arm.tick"]["now"] is None
    assert not page["timers"]["arm.tick"]["known"]
    assert page["components"]["arm"]["state"] == "unknown"
    left = page["computers"]["left"]
    assert (left["state"], left["age"]) == ("not known", 12)
    assert "used" not in left
    (connector,) = page["connectors"].values()
    assert (connector["kind"], connector["rate"]) == ("unknown", None)


def test_nothing_is_known_now_of_a_timer_whose_container_is_silent() -> None:
    state = PageState()
    assert not state.of(seen(at=1.0), 0.0)["timers"]["arm.tick"]["known"]
    assert state.of(seen(at=2.0), 1.0)["timers"]["arm.tick"]["known"]
    for second in range(2, 7):
        page = state.of(seen(at=2.0), second)
    assert page["timers"]["arm.tick"]["now"] is None
    assert not page["timers"]["arm.tick"]["known"]


@pytest.mark.parametrize(("hanging", "shown"), [((), 0), (("arm",), 7.0)])
def test_what_hangs_is_what_the_policy_says(
    hanging: tuple[str, ...], shown: float
) -> None:
    """A detector that waited 50 ms for its GPU was marked as hanging."""
    known = seen()
    assert known.status is not None
    left = known.status.computers["left"]
    (container,) = left.containers
    (arm,) = container.components
    arm = replace(arm, hung=7.04)
    container = replace(container, components=(arm,))
    computers = {"left": replace(left, containers=(container,))}
    status = replace(known.status, computers=computers, hanging=hanging)
    page = PageState().of(replace(known, status=status), 0.0)
    assert page["components"]["arm"]["hung"] == shown


def test_what_was_never_measured_is_no_zero() -> None:
    known = seen()
    assert known.status is not None
    hops = (ChainHop(component="arm", computer="left"),)
    report = ChainReport(
        name="reach", deadline=0.2, missed=0, age=Summary(), error=0.0, hops=hops
    )
    status = replace(known.status, chains=(report,))
    page = PageState().of(replace(known, status=status), 0.0)
    chain = page["chains"]["reach"]
    assert (chain["median"], chain["p99"], chain["hops"]) == (
        None,
        None,
        [["arm", None]],
    )
    assert page["timers"]["arm.tick"]["p99"] is None


def test_the_history_has_a_moment_a_second_for_ten_minutes() -> None:
    history = RecentHistory()
    page: Page = {
        "computers": {"left": {"used": 1.0, "capacity": 4.0}, "right": {}},
        "timers": {"arm.tick": {"deadline": 0.1, "now": 0.25}},
    }
    for second in range(700):
        uses = 10 * second
        chain = {"uses": uses, "mean": 0.05, "deadline": 0.1, "known": second != 699}
        history.note({**page, "chains": {"see": chain}}, LiveReading(at=second + 0.1))
        history.note({**page, "chains": {"see": chain}}, LiveReading(at=second + 0.6))
    moments = history.moments()
    assert len(moments) == 600
    assert moments["698"] == {
        "cpu": {"left": 0.25, "right": None},
        "ages": {"see": 0.5},
        "late": 0.25,
    }
    assert moments["699"]["ages"] == {"see": None}
