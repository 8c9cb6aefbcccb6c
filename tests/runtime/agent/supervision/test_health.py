"""What an agent knows of each container's health."""

from __future__ import annotations

from poise.runtime.supervision.health import HealthRecords


def test_counts_the_restarts_of_the_last_minute() -> None:
    now = [100.0]
    health = HealthRecords(clock=lambda: now[0])
    health.note_start("c")
    for moment in (110.0, 120.0, 150.0):
        now[0] = moment
        health.note_fault("c", "broke")
        health.enter("c", "restarting")
        health.note_start("c")
    for moment, lately in ((150.0, 3), (175.0, 2), (185.0, 1), (211.0, 0)):
        now[0] = moment
        (record,) = health.records({})
        assert (record.restarts, record.restarts_lately) == (3, lately)


def test_a_container_that_was_stopped_begins_without_faults_and_restarts() -> None:
    health = HealthRecords()
    health.note_start("c")
    health.note_fault("c", "was killed by SIGKILL")
    health.enter("c", "restarting")
    health.note_start("c")
    health.forget("c")
    health.note_start("c")
    (record,) = health.records({})
    assert (record.restarts, record.last_fault) == (0, None)
    assert len(health.faults()) == 1


def test_a_fault_says_how_long_its_agent_had_run_whatever_the_time_of_day() -> None:
    now = [100.0]
    health = HealthRecords(clock=lambda: now[0])
    now[0] = 107.0
    health.note_fault("c", "broke")
    (fault,) = health.faults()
    assert fault.uptime == 7.0
