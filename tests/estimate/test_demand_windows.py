"""What windows show that is needed; a window is half a second."""

import pytest

from poise.estimate.online import Reading, Sums, Window, demand_in, window_between


def window(cpu: float, asked: int, done: int, *, had_cpu_left: bool = False) -> Window:
    return Window(0.5, cpu, asked, done, had_cpu_left=had_cpu_left)


def test_who_keeps_up_needs_what_it_used() -> None:
    """0.2 s in 1 s; one job is still under way, and may cost what nine did each."""
    found = demand_in([window(0.1, 5, 5), window(0.1, 5, 4)])
    assert found.cores == pytest.approx(0.2)
    assert found.error == pytest.approx(0.2 / 9)


def test_who_does_not_keep_up_needs_jobs_a_second_times_what_one_costs() -> None:
    """Each window ends one of 10 that come, for 0.05 s: 20 a second need a core."""
    found = demand_in([window(0.05, 10, 1)] * 5)
    assert found.cores == pytest.approx(1.0)
    # one of four windows may belong to another job, one of 50 jobs came or not
    assert found.error == pytest.approx(1 / 4 + 1 / 50)


@pytest.mark.parametrize(("full", "cores", "undone"), [(1, 0.1, 0.0), (2, 1.0, 0.9)])
def test_who_does_not_keep_up_where_cpu_was_to_be_had_needs_what_it_used(
    full: int, cores: float, undone: float
) -> None:
    """It waits for something else; the computer was full for 1 or 2 windows of 10."""
    windows = [window(0.05, 10, 1, had_cpu_left=k >= full) for k in range(10)]
    assert demand_in(windows).cores == pytest.approx(cores)
    assert Sums(windows).undone == pytest.approx(undone)


def test_who_works_off_what_waited_needs_less_also_where_there_is_room() -> None:
    found = demand_in([window(0.2, 5, 10, had_cpu_left=True)] * 4)
    assert found.cores == pytest.approx(0.2)


def test_a_job_that_is_still_under_way_costs_the_others_nothing() -> None:
    """Two jobs of 0.1 s, then 0.4 s of one that has not ended; 8 a second come."""
    ended = [window(0.1, 4, 1), window(0.1, 4, 1), window(0.1, 4, 1)]
    found = demand_in([*ended, *[window(0.1, 4, 0)] * 4])
    assert found.cores == pytest.approx(0.8)


def test_who_works_off_what_waited_needs_less_than_it_uses() -> None:
    """10 a second come, 20 are done, for 0.4 cores."""
    found = demand_in([window(0.2, 5, 10)] * 4)
    assert found.cores == pytest.approx(0.2)


@pytest.mark.parametrize("done", [(0, 0, 0), (0, 1, 0)])
def test_without_jobs_that_ended_only_what_was_used_is_known(
    done: tuple[int, ...],
) -> None:
    """One end is none: when that job began is not known."""
    found = demand_in([window(0.1, 10, n) for n in done])
    assert found.cores == pytest.approx(0.2)
    assert found.error is None


def test_the_share_of_jobs_that_went_undone_is_known() -> None:
    assert Sums([window(0.1, 10, 4)]).undone == pytest.approx(0.6)
    assert Sums([window(0.1, 10, 9)]).undone == 0.0
    assert Sums([window(0.1, 4, 10)]).undone == 0.0


def test_to_whom_nothing_comes_any_more_needs_nothing_or_one_job() -> None:
    """10 jobs that waited are done in 1 s, for 0.05 s each."""
    found = demand_in([window(0.25, 0, 5)] * 2)
    assert found.cores == 0
    assert found.error == pytest.approx(0.05)


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


@pytest.mark.parametrize("speed", [0.5, 1.0])
def test_who_wanted_all_of_a_slow_core_is_cut(speed: float) -> None:
    """Its 0.2 s are 0.1 s of the reference computer."""
    window = window_between(Reading(0.0, 0.0), Reading(0.2, 0.05, 0.05, speed=speed))
    assert window is not None
    assert window.is_cut is (speed == 0.5)


def test_who_ran_all_the_time_or_waited_a_little_is_not_cut() -> None:
    before = Reading(0.0, 0.0)
    for cpu, wait in ((0.2, 0.0), (0.05, 0.05), (0.19, 0.01)):
        window = window_between(before, Reading(0.2, cpu, wait))
        assert window is not None
        assert not window.is_cut
