"""What `poise status` says of what components need, in 80 columns."""

from __future__ import annotations

import re
from io import StringIO

import pytest
from msgspec.structs import replace
from rich.console import Console

from poise.estimate.online import Drift, Estimate
from poise.manage.control_socket.commands import RobotStatus
from poise.manage.migration.migration_report import WhatIf
from poise.manage.observe.chains import ChainHop, ChainReport
from poise.manage.observe.estimates import DemandEstimate, Load
from poise.manage.tasks.task_reports import TaskReport, TaskState
from poise.plan import Terms
from poise.session.render.status_tables import (
    _remarks,
    component_table,
    computer_table,
    container_lines,
    container_table,
    growing_containers,
    remarks,
    status_parts,
)
from poise.session.render.tables import chain_tables, table, task_table, what_if_lines
from poise.wire.records.request_records import ManagerId
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ContainerHealth,
    ContainerStatus,
    Fault,
    Summary,
    TimerStatus,
)

NAME = "recommendation_presenter"


def status(estimate: Estimate) -> RobotStatus:
    component = ComponentStatus(name=NAME, state="active", errors=12)
    container = ContainerStatus(name="one", pid=1, components=(component,))
    agent = AgentStatus(
        computer="vision", generation=1, uptime=9.0, cpu=1.0, containers=(container,)
    )
    standing = DemandEstimate(
        component=NAME, computer="vision", expected=0.05, estimate=estimate
    )
    return RobotStatus(
        robot="r",
        task="work",
        manager=ManagerId(key="k", user="ann", host="desk", pid=7, since=0.0),
        placement={NAME: "vision"},
        computers={"vision": agent},
        demand_estimates=(standing,),
    )


def lines(answer: RobotStatus) -> list[str]:
    out = StringIO()
    Console(file=out, width=80).print(component_table(answer))
    return out.getvalue().splitlines()[2:]


def test_says_what_is_needed_how_sure_that_is_and_what_was_expected() -> None:
    drift = Drift(1.0, 0.05, 0.1)
    estimate = Estimate(mean=0.1, p95=0.1, error=0.012, starved=0.4, drift=drift)
    answer = status(estimate)
    (row,) = lines(answer)
    assert "10.0% ± 1.2%" in row
    assert "5.0%" in row
    assert list(remarks(answer)) == [f"{NAME}: 12 errors, starved 40%"]


def test_what_lacks_cpu_and_has_no_jobs_needs_at_least_what_it_got() -> None:
    estimate = Estimate(mean=0.1, p95=0.1, error=0.01, starved=1.0, is_least=True)
    (row,) = lines(status(estimate))
    assert "at least 10.0%" in row
    assert "±" not in row


def test_a_single_missed_deadline_is_counted() -> None:
    timer = TimerStatus(
        name="look",
        period=0.1,
        deadline=0.1,
        releases=7200,
        missed=1,
        lateness=Summary(),
        duration=Summary(),
    )
    component = ComponentStatus(name=NAME, state="active", timers=(timer,))
    assert [*_remarks(component, None)] == ["look missed 1 of 7,200 deadlines"]


def test_a_starved_component_is_shown_with_the_culprit() -> None:
    load = Load(capacity=1.0, used=1.0, components={"spinner": 0.9, NAME: 0.1})
    answer = status(Estimate(mean=0.1, p95=0.1, error=0.012, starved=0.8))
    answer = replace(answer, loads={"vision": load})
    culprit = "component 'spinner' takes 0.9 cores there"
    assert list(remarks(answer)) == [f"{NAME}: 12 errors, starved 80% ({culprit})"]


def test_what_rests_lacks_nothing() -> None:
    estimate = Estimate(mean=0.1, p95=0.1, error=0.01, starved=0.4, long_job=9.0)
    answer = status(estimate)
    (standing,) = answer.demand_estimates
    resting = ComponentStatus(name=NAME, state="inactive")
    assert [*_remarks(resting, standing)] == []


def test_of_what_was_started_often_the_last_start_is_shown() -> None:
    starts: tuple[tuple[str, TaskState], ...] = (
        ("a", "done"),
        ("b", "done"),
        ("a", "failed"),
        ("b", "going"),
    )
    tasks = [
        TaskReport(name=name, state=state, priority=0, why="", began=at, since=at)
        for at, (name, state) in enumerate(starts)
    ]
    answer = replace(status(Estimate(mean=0.1, p95=0.1, error=0.01)), tasks=(*tasks,))
    said = [part for part in status_parts(answer) if "task '" in str(part)]
    assert said == ["[red]task 'a' is failed[/]", "task 'b' is going"]
    assert "everything else is as the robot file says" in list(status_parts(answer))


def test_a_component_with_a_job_that_does_not_end_is_named() -> None:
    estimate = Estimate(mean=1.0, p95=1.0, error=0.0, long_job=25.0)
    answer = status(estimate)
    expected = f"{NAME}: 12 errors, a job has computed for 25 s and not ended"
    assert list(remarks(answer)) == [expected]


def test_the_state_on_a_computer_that_is_out_of_reach_is_unknown() -> None:
    answer = status(Estimate(mean=0.1, p95=0.1, error=0.012))
    assert "active" in lines(answer)[0]
    (row,) = lines(replace(answer, out_of_reach={"vision": 0.0}))
    assert "unknown" in row
    assert "active" not in row


def test_what_was_wrong_on_a_computer_that_is_out_of_reach_is_not_said_of_now() -> None:
    answer = status(Estimate(mean=0.1, p95=0.1, error=0.01, starved=0.4))
    health = ContainerHealth(
        name="one", state="running", since=9.0, growth=1 << 20, full_in=9.0
    )
    agent = replace(answer.computers["vision"], health=(health,))
    answer = replace(answer, computers={"vision": agent})
    assert list(remarks(answer)) == [f"{NAME}: 12 errors, starved 40%"]
    assert list(growing_containers(answer))
    assert container_table(answer).row_count
    answer = replace(answer, out_of_reach={"vision": 0.0})
    assert list(remarks(answer)) == [f"{NAME}: 12 errors"]
    assert not list(growing_containers(answer))
    assert not container_table(answer).row_count


def test_says_what_was_raised_last_whatever_it_holds() -> None:
    error = "Traceback (most recent call last):\n  somewhere\nKeyError: '[/red]'"
    answer = status(Estimate(mean=0.1, p95=0.1, error=0.01))
    container = answer.computers["vision"].containers[0]
    component = replace(container.components[0], error=error)
    (said,) = _remarks(component, None)
    out = StringIO()
    Console(file=out, width=80).print(said)
    assert out.getvalue() == "12 errors (KeyError: '[/red]')\n"


def test_says_that_a_starved_component_may_need_more() -> None:
    """Too few of its jobs have ended to tell what one costs."""
    (row,) = lines(status(Estimate(mean=0.1, p95=0.1, error=None, starved=0.9)))
    assert "at least 10.0%" in row


def test_a_new_component_is_only_not_known_well() -> None:
    (row,) = lines(status(Estimate(mean=0.1, p95=0.1, error=None)))
    assert "at least" not in row
    assert "10.0%" in row


def test_says_what_computers_use_and_how_often_containers_restarted() -> None:
    fault = Fault(container="one", message="was killed by SIGKILL", number=1, at=5.0)
    health = ContainerHealth(
        name="one", state="running", since=9.0, restarts=2, last_fault=fault
    )
    answer = status(Estimate(mean=0.1, p95=0.1, error=0.01))
    agent = replace(
        answer.computers["vision"], load=0.25, memory=3 << 20, health=(health,)
    )
    answer = replace(answer, computers={"vision": agent})
    out = StringIO()
    Console(file=out, width=80).print(computer_table(answer))
    row = re.split("  +", out.getvalue().splitlines()[-1].strip())
    assert row == ["vision", "0.25 cores by Poise alone", "3 MiB", "1", "2"]
    for others, cpu in (
        (0.7, "0.95 cores, 0.70 by other programs"),
        (0.0, "0.25 cores"),
    ):
        loads = {"vision": Load(capacity=4.0, used=1.0, background=others)}
        busy = replace(answer, loads=loads, capacities={"vision": {"cpu": 4.0}})
        Console(file=out, width=80).print(computer_table(busy))
        assert f"  {cpu}  3 MiB  " in out.getvalue()
    (line,) = container_lines(answer)
    assert line.startswith("container 'one' on 'vision': running since ")
    assert "2 restarts (counters began again then); last fault at " in line
    assert line.endswith(": was killed by SIGKILL")


@pytest.mark.parametrize(
    ("faults", "says"),
    [
        (0, "everything is as the robot file says"),
        (
            1,
            "everything is as the robot file says; 1 fault since the start (below)",
        ),
        (
            2,
            "everything is as the robot file says; 2 faults since the start (below)",
        ),
    ],
)
def test_says_that_all_is_well_and_what_was_not(faults: int, says: str) -> None:
    answer = replace(status(Estimate(mean=0.1, p95=0.1, error=0.01)), faults=faults)
    assert says in list(status_parts(answer))


def test_names_are_never_cut() -> None:
    names = "a" * 60, "b" * 60
    rows = table("component", "computer", "state", folds=1)
    rows.add_row(*names, "active")
    out = StringIO()
    Console(file=out, width=80).print(rows)
    text = out.getvalue()
    assert (text.count("a"), text.count("b")) == (60 + 2, 60)  # "state", "active"
    assert max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize("width", [40, 78])
def test_names_are_there_however_narrow_the_terminal(width: int) -> None:
    rows = table("Q" * 8, *["figure of it"] * 5)
    rows.add_row("q" * 12, *["123.4 ms ± 5 ms"] * 5)
    out = StringIO()
    Console(file=out, width=width).print(rows)
    assert (out.getvalue().count("Q"), out.getvalue().count("q")) == (8, 12)


def shown(answer: RobotStatus) -> str:
    out = StringIO()
    for part in status_parts(answer):
        Console(file=out, width=80).print(part)
    return out.getvalue()


def test_what_an_agent_reported_long_ago_is_not_called_fine() -> None:
    answer = status(Estimate(mean=0.1, p95=0.1, error=0.01))
    fresh = shown(replace(answer, ages={"vision": 0.4}))
    assert "everything is as the robot file says" in fresh
    assert "ago" not in fresh
    stale = shown(replace(answer, ages={"vision": 12.0}))
    assert "not known how these are now: vision" in stale
    assert "everything is as the robot file says" not in stale
    assert "12 s ago" in stale
    assert "active" not in stale


def test_a_computer_that_never_reported_is_shown_as_not_known() -> None:
    answer = status(Estimate(mean=0.1, p95=0.1, error=0.01))
    text = shown(replace(answer, capacities={"vision": {}, "main": {}}))
    assert "not known how these are now: main" in text
    row = next(line for line in text.splitlines() if line.startswith("main"))
    assert row.split() == ["main", *["not", "known"] * 4, "never"]


def test_says_what_containers_hold_and_what_was_expected() -> None:
    answer = status(Estimate(mean=0.1, p95=0.1, error=0.01))
    health = ContainerHealth(
        name="one",
        state="running",
        since=9.0,
        memory=300 << 20,
        growth=2 << 20,
        limit=512 << 20,
        full_in=40.0,
    )
    agent = replace(answer.computers["vision"], health=(health,))
    answer = replace(
        answer, computers={"vision": agent}, memory_demands={NAME: 100 << 20}
    )
    out = StringIO()
    Console(file=out, width=120).print(container_table(answer))
    row = out.getvalue().splitlines()[-1]
    for text in ("one", "300 MiB", "100 MiB", "2 MiB/s: 512 MiB in 40 s", NAME):
        assert text in row


def test_chains_fit_80_columns_and_say_which_step_takes_most() -> None:
    """The localiser's data is 60 ms old, the driver's 70: most is the localiser's."""
    steps = ("scanner", 0.0), ("localiser", 0.06), ("driver", 0.07)
    hops = tuple(
        ChainHop(component=name, computer="main", age=ages(age)) for name, age in steps
    )
    chain = ChainReport(
        name="pose", deadline=0.2, missed=1, age=ages(0.07), error=0.02, hops=hops
    )
    out = StringIO()
    for rows in chain_tables([chain]):
        Console(file=out, width=80).print(rows)
    row = out.getvalue().splitlines()[-1].split()
    assert row[:5] == ["pose", "200", "ms", "4", "25.0%"]
    assert " ".join(row[5:10]) == "70 ms ± 20 ms"
    assert row[-1] == "localiser"


def test_a_chain_through_a_silent_computer_is_not_shown_as_if_it_were_live() -> None:
    answer = status(Estimate(mean=0.1, p95=0.1, error=0.01))
    hops = (ChainHop(component=NAME, computer="vision"),)
    chain = ChainReport(
        name="pose", deadline=0.2, missed=0, age=ages(0.07), error=0.0, hops=hops
    )
    live = replace(answer, chains=(chain,), ages={"vision": 0.1})
    old = "not known how old this data is now: pose"
    assert old not in shown(live)
    assert old in shown(replace(live, ages={"vision": 12.0}))


def ages(value: float) -> Summary:
    return Summary(count=4, mean=value, median=value, p99=value, maximum=value)


def test_a_list_of_tasks_fits_80_columns() -> None:
    task = TaskReport(
        name="serve_beverage",
        state="waiting",
        began=0.0,
        since=0.0,
        priority=5,
        why="task 'wave' uses the device 'arm', which both of them need all the time",
    )
    out = StringIO()
    Console(file=out, width=80).print(task_table([task]))
    assert max(map(len, out.getvalue().splitlines())) <= 80
    assert "which both of them need" in " ".join(out.getvalue().split())


@pytest.mark.parametrize(
    ("downtime", "says"),
    [
        (0.766, "mapper is paused for about 766 ms, as in its last move"),
        (None, "mapper was not moved yet, so nobody knows for how long it is"),
    ],
)
def test_no_pause_is_promised_that_was_not_measured(
    downtime: float | None, says: str
) -> None:
    same = Terms(total=0.1, communication=0.1, balance=0.0)
    seen = WhatIf(
        component="mapper",
        source="main",
        target="vision",
        now=same,
        then=same,
        downtime=downtime,
        state=8_000_000,
    )
    assert any(says in line for line in what_if_lines(seen))


def test_a_long_parameter_does_not_hide_the_rest() -> None:
    """One of 15 MB was printed as a whole."""
    answer = status(Estimate(mean=0.1, p95=0.1, error=0.01))
    said = shown(replace(answer, parameters={NAME: {"mask": "y" * 10_000, "n": 1}}))
    assert "mask = yyy" in " ".join(said.split())
    assert "n = 1" in said
    assert said.count("y") < 200
