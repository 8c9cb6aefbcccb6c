"""Which faults are new."""

from __future__ import annotations

import time

from msgspec.structs import replace

from poise.manage.observe.deviations import (
    FaultFilter,
    combined,
    fault_sentence,
    faults_after,
    last_numbers,
)
from poise.wire.records.status_records import AgentStatus, Fault


def status(*numbers: int) -> dict[str, AgentStatus]:
    faults = tuple(Fault(container="c", message=f"f{n}", number=n) for n in numbers)
    agent = AgentStatus(computer="left", generation=1, uptime=9, cpu=0, faults=faults)
    return {"left": agent}


def messages(before: dict[str, AgentStatus], now: dict[str, AgentStatus]) -> list[str]:
    found = faults_after(last_numbers(before), now)
    return [fault.message for _, fault in found]


def test_faults_of_before_are_not_new() -> None:
    """An agent keeps its faults for as long as it lives, also those of minutes ago."""
    assert messages(status(1, 2), status(1, 2)) == []
    assert messages(status(1, 2), status(2, 3, 4)) == ["f3", "f4"]


def test_all_faults_of_an_agent_that_was_not_known_are_new() -> None:
    assert messages({}, status(1)) == ["f1"]


def test_all_faults_of_an_agent_that_began_again_are_new() -> None:
    assert messages(status(1, 2, 3), status(1)) == ["f1"]


def test_the_sentence_names_the_container_the_computer_and_restarts() -> None:
    fault = Fault(container="c", message="was killed by SIGKILL", restarts=2)
    assert fault_sentence("left", fault) == (
        "container 'c' on 'left' was killed by SIGKILL (restarts before: 2)"
    )


def test_equal_faults_are_one_sentence_with_number_and_last_time() -> None:
    at = 1e9
    other = Fault(container="d", message="broke", at=at)
    same = [replace(other, container="c", at=at - n) for n in (2, 1, 0)]
    last = time.strftime("%H:%M:%S", time.localtime(at))
    assert list(combined(("left", fault) for fault in [*same, other])) == [
        f"container 'c' on 'left' broke (3 times, last at {last})",
        f"container 'd' on 'left' broke (at {last})",
    ]


def test_old_faults_of_an_agent_that_is_reached_late_are_not_new() -> None:
    """An earlier manager has told of them, if they are older than this one."""
    filtered = FaultFilter({}, since=100.0)
    agent = status(1, 2)["left"]
    old, young = agent.faults
    faults = replace(old, uptime=400.0), replace(young, uptime=495.0)
    late = {"left": replace(agent, uptime=500.0, faults=faults)}
    assert [fault.message for _, fault in filtered.new(late, 110.0)] == ["f2"]
    assert not [*filtered.new(late, 110.2)]
    assert filtered.count == 1


def test_of_an_endless_crash_loop_a_line_a_minute_is_told() -> None:
    """One fault each 5 s for 3 minutes: five lines, and then one a minute."""
    told = []
    filtered = FaultFilter({})
    for number in range(1, 37):
        now = 5.0 * number
        new = filtered.new(status(number), now)
        told += [(now, sentence.partition("' f")[2]) for sentence, _ in new]
        assert filtered.close("left", "c") == bool(told and told[-1][0] == now)
    loud = [(5.0 * n, f"{n}") for n in (1, 2, 3, 4)]
    # from 25 s on: 12 faults a minute, of which 11 are not told
    assert told == [
        *loud,
        (25.0, "5; from now on one line a minute"),
        (85.0, "17; 11 more since the last line; from now on one line a minute"),
        (145.0, "29; 11 more since the last line; from now on one line a minute"),
    ]
    assert filtered.count == 36


def test_the_end_of_a_fault_is_told_as_the_fault_was() -> None:
    filtered = FaultFilter({})
    kinds = []
    for number in range(1, 15):
        fault = Fault(
            container="c", message="f", number=number, is_over=number % 2 == 0
        )
        agent = AgentStatus(
            computer="left", generation=1, uptime=9, cpu=0, faults=(fault,)
        )
        kinds += [
            fault.is_over for _, fault in filtered.new({"left": agent}, 1.0 * number)
        ]
    assert kinds == [False, True] * 5
    assert filtered.count == 7
