"""Whether the host kept a promise."""

from __future__ import annotations

import pytest

from poise.emulate.limits import Usage, is_starved, starved_time
from poise.kernel_counters import stolen_time

START = Usage(used=10.0, starved=1.0)


@pytest.mark.parametrize(
    ("used", "starved", "quota", "cpus", "expected"),
    [
        (0.5, 0.0, 0.5, 1, False),
        # It advanced at 0.5 / (0.5 + 0.4) = 0.56 of a CPU; promised: 0.5.
        (0.5, 0.4, 0.5, 1, False),
        # 0.3 / (0.3 + 0.5) = 0.375 < 0.5 - 10 %.
        (0.3, 0.5, 0.5, 1, True),
        # The same is enough for 0.8 cores on two CPUs: 0.4 - 10 % = 0.36 of each.
        (0.3, 0.5, 0.8, 2, False),
        # All of a CPU: 10 % may be missing, 20 % may not.
        (0.92, 0.08, 1.0, 1, False),
        (0.8, 0.2, 1.0, 1, True),
        # A few turns of others are nobody's fault.
        (0.01, 0.04, 0.5, 1, False),
        (0.01, 0.06, 0.5, 1, True),
        # Four cores on two CPUs: more than all of both cannot be promised.
        (1.9, 0.1, 4.0, 2, False),
    ],
)
def test_starved_is_who_advanced_slower_than_promised(
    used: float, starved: float, quota: float, cpus: int, *, expected: bool
) -> None:
    after = Usage(used=10.0 + used, starved=1.0 + starved)
    assert is_starved(START, after, quota, cpus) is expected


def test_nobody_is_called_starved_where_the_kernel_does_not_tell() -> None:
    assert not is_starved(Usage(used=0.0), Usage(used=0.0), 0.5)


def test_throttled_time_is_not_starved_time() -> None:
    text = (
        "some avg10=0.00 avg60=0.00 avg300=0.00 total=9000000\n"
        "full avg10=0.00 avg60=0.00 avg300=0.00 total=1500000\n"
    )
    # 1.5 s runnable and not running, 1.2 s of it throttled.
    assert starved_time(text, 1.2, cpus=1) == pytest.approx(0.3)
    # On two CPUs the mean was 1.5 s, the sum 3 s.
    assert starved_time(text, 1.2, cpus=2) == pytest.approx(1.8)


def test_what_is_prepared_waits_for_cpu_that_nobody_promised_it() -> None:
    text = "full avg10=0.00 avg60=0.00 avg300=0.00 total=1500000\n"
    prepared = "full avg10=0.00 avg60=0.00 avg300=0.00 total=900000\n"
    assert starved_time(text, 0.5, 1, prepared) == pytest.approx(0.1)
    assert starved_time(text, 0.5, 2, prepared) == pytest.approx(0.7)


def test_kernel_that_does_not_count_full_pressure_does_not_tell() -> None:
    # Linux 4.20 to 5.12
    text = "some avg10=0.00 avg60=0.00 avg300=0.00 total=9000000\n"
    assert starved_time(text, 0.0, cpus=1) is None


def test_stolen_time_is_that_of_the_cpus_asked_for() -> None:
    assert stolen_time([]) == 0
    assert stolen_time([0]) >= 0
