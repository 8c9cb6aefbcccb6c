"""What a simulation prints: the verdict first, the worst first."""

from __future__ import annotations

import re

import pytest
from msgspec.structs import replace

from poise.manage.tasks.task_reports import TaskReport
from poise.session.render.simulation_tables import compared, late, span, verdict
from poise.session.simulate import Simulation, SimulationComparison
from poise.simulation.faults import SimulatedFault
from poise.simulation.simulation_report import SimulatedEvent, SimulationReport
from tests.session.fake_rehearsal import REPORT, timer


def lines(report: SimulationReport) -> list[str]:
    return str(Simulation.of(report)).splitlines()


def line(report: SimulationReport, begin: str) -> list[str]:
    """Return the cells of the row that begins so."""
    (found,) = (each for each in lines(report) if each.startswith(begin))
    return re.split(r"\s{2,}", found.strip())


@pytest.mark.parametrize(
    ("seconds", "says"),
    [
        (0.5, "500 ms"),
        (59.0, "59 s"),
        (60.0, "1 min"),
        (95.0, "1 min 35 s"),
        (3600.0, "1 h"),
        (5430.0, "1 h 30 min"),
    ],
)
def test_long_times_are_in_hours_and_minutes(seconds: float, says: str) -> None:
    assert span(seconds) == says


def test_the_first_line_is_the_verdict() -> None:
    """25 of 2000: the timer without a deadline does not count."""
    assert lines(REPORT)[0] == (
        "1 h of virtual time: 25 of 2000 deadlines missed (1.25%), greeting stopped, "
        "for up to 6.5 s, 1 move"
    )


def test_a_quiet_simulation_says_so() -> None:
    quiet = replace(REPORT, timers=(timer("a", 10, 0),), outages=(), moves=())
    assert verdict(quiet) == (
        "1 h of virtual time: none of 10 deadlines missed, no function stopped"
    )
    assert "no timer has a deadline" in verdict(replace(quiet, timers=()))


def test_a_task_that_ended_is_told_with_the_reason_and_the_time() -> None:
    why = "action 'go' failed: its limit of 20 s is over"
    over = TaskReport(
        name="haul", state="failed", priority=0, why=why, began=100.0, since=140.0
    )
    goes_on = replace(over, name="roam", state="going", why="")
    report = replace(REPORT, tasks=(over, goes_on))
    assert lines(report)[1] == f"task 'haul' failed after 40 s: {why}"
    assert "roam" not in str(Simulation.of(report))


def test_a_violated_promise_comes_before_all_else() -> None:
    broken = replace(
        REPORT, violations=("nothing-active-twice: [a]", "commands-end: b")
    )
    assert lines(broken)[0] == (
        "a defect of Poise: 2 promises did not hold in 1 h of virtual time: "
        "nothing-active-twice: [a]"
    )
    assert "a promise of Poise did not hold: commands-end: b" in lines(broken)


def test_one_that_was_ended_early_says_so() -> None:
    early = replace(REPORT, seconds=600.0)
    assert verdict(early).startswith("10 min of 1 h of virtual time, then it was ended")
    assert not Simulation.of(replace(REPORT, seconds=3600 - 1e-5)).is_early


def test_computers_have_cpu_memory_and_components() -> None:
    assert line(REPORT, "left ") == [
        "left",
        "25.0%",
        "75.0%",
        "1 MiB of 1 GiB",
        "counter",
    ]
    assert line(REPORT, "right ")[3] == "1 MiB"


def test_an_infinite_capacity_is_none() -> None:
    endless = replace(REPORT.loads[0], memory_capacity=float("inf"))
    assert "inf" not in str(Simulation.of(replace(REPORT, loads=(endless,))))


def test_the_worst_timer_comes_first_and_one_without_deadline_never() -> None:
    assert [each.component for each in late(REPORT.timers)] == ["counter", "printer"]
    said = str(Simulation.of(REPORT))
    assert said.index("counter.tick") < said.index("printer.tick")
    assert "b.tick" not in said


def test_what_is_too_much_is_counted() -> None:
    many = tuple(timer(f"c{number:02}", 10, 1) for number in range(15))
    said = str(Simulation.of(replace(REPORT, timers=many)))
    assert "c11.tick" in said
    assert "c12.tick" not in said
    assert "3 more late timers; `--json` has all" in said


def test_chains_moves_outages_and_guesses_are_there() -> None:
    said = str(Simulation.of(REPORT))
    for text in ("25.0%", "'right' is lost", "6.5 s", "10 min 5 s", "assumed: printer"):
        assert text in said
    assert "36000 messages processed, 3 dropped" in said


def test_faults_are_listed_and_too_many_are_counted() -> None:
    fault = SimulatedFault(kind="kill agent", target="right", lasts=2.9, at=536.758)
    events = [
        SimulatedEvent(at=fault.at, who="fault", kind="fault", what=str(fault)),
        SimulatedEvent(at=540.0, who="left", kind="lost", what="'right' is lost"),
    ]
    said = lines(replace(REPORT, events=(events[0], events[1])))
    assert said.count("fault at 536.76 s: kill agent right for 2.90 s") == 1
    said = lines(replace(REPORT, events=(*events, *14 * events[:1])))
    assert sum(each.startswith("fault at ") for each in said) == 12
    assert "3 more faults; `--json` has all" in said


def test_a_chain_that_was_never_used_has_no_ages() -> None:
    never = replace(REPORT.chains[0], uses=0, missed=0, median=float("nan"))
    assert "nan" not in str(Simulation.of(replace(REPORT, chains=(never,))))


def test_the_last_line_compares_with_real_time() -> None:
    """3600 s in 48 s: 75 times."""
    assert lines(REPORT)[-1] == (
        "1 h of virtual time took 48 s of CPU time, 75 times real time; auto "
        "placement, seed 7"
    )


def test_names_are_no_markup() -> None:
    odd = replace(REPORT.outages[0], function="[red]x[/]")
    assert "[red]x[/]" in str(Simulation.of(replace(REPORT, outages=(odd,))))


def test_no_share_of_deadlines_is_known_where_no_timer_has_any() -> None:
    assert compared("auto", replace(REPORT, timers=()))[1] == ""


def test_a_comparison_has_a_row_for_each_placement() -> None:
    assert compared("static", REPORT) == (
        "static",
        "1.25%",
        "left 25% (75%), right 50% (100%)",
        "25.00%",  # of 100 uses of the chain
        "1",
        "1",
        "6.5 s",
        "3",
    )
    results = {each: Simulation.of(REPORT) for each in ("auto", "static")}
    broken = Simulation.of(replace(REPORT, violations=("it broke",)))
    both = SimulationComparison(results=results)
    assert [each.split()[0] for each in str(both).splitlines()[2:]] == [*results]
    assert not both.failed
    worse = SimulationComparison(results={**results, "static": broken})
    assert worse.failed
    assert "a promise of Poise did not hold: static: it broke" in str(worse)
