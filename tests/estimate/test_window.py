import pytest

from poise.estimate.window import Reading, window_between


def test_a_window_is_the_difference_of_two_readings() -> None:
    before = Reading(10.0, 1.0, 0.25, 100, 99)
    window = window_between(before, Reading(10.5, 1.25, 0.25, 105, 104))
    assert window is not None
    assert (window.seconds, window.cpu) == (0.5, 0.25)
    assert (window.asked, window.done, window.is_cut) == (5, 5, False)


def test_there_is_none_across_a_restart_or_without_time() -> None:
    before = Reading(10.0, 1.0, 0.0, 100, 100)
    assert window_between(before, Reading(10.2, 0.1, 0.0, 2, 2)) is None
    assert window_between(before, Reading(10.2, 0.1, 0.0, 100, 100)) is None
    assert window_between(before, before) is None


def test_a_call_that_ends_is_taken_off_its_caller() -> None:
    """Else what it counted for the caller before would stay."""
    window = window_between(Reading(10.0, 1.5), Reading(10.1, 1.47))
    assert window is not None
    assert window.cpu == pytest.approx(-0.03)


def test_who_wanted_to_run_all_the_time_and_could_not_is_cut() -> None:
    """0.1 s on a CPU and 0.1 s waiting in 0.2 s: it may have wanted more."""
    before = Reading(0.0, 0.0)
    cut = window_between(before, Reading(0.2, 0.1, 0.1))
    assert cut is not None
    assert cut.is_cut


def test_who_ran_all_the_time_or_waited_a_little_is_not_cut() -> None:
    before = Reading(0.0, 0.0)
    for cpu, wait in ((0.2, 0.0), (0.05, 0.05), (0.19, 0.01)):
        window = window_between(before, Reading(0.2, cpu, wait))
        assert window is not None
        assert not window.is_cut
