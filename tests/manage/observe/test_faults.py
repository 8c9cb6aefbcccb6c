"""Which faults are new."""

from __future__ import annotations

from poise.manage.observe.faults import fault_sentence, faults_after, last_numbers
from poise.wire.records.deployment import AgentStatus, Fault


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
