"""A simulation as one page: it stands alone, and shows what happened when."""

from __future__ import annotations

import re

from msgspec.structs import replace

from poise.session.simulate import Simulation, SimulationComparison
from poise.simulation.simulation_report import SimulationReport
from tests.session.fake_rehearsal import REPORT


def page(report: SimulationReport) -> str:
    return Simulation.of(report).page()


def test_it_needs_no_other_file_and_no_host() -> None:
    both = SimulationComparison(results={"auto": Simulation.of(REPORT)})
    for each in (page(REPORT), both.page()):
        assert not re.findall(r"(?:src|href)=|url\(|@import|//[a-z]", each)


def test_it_begins_with_the_verdict() -> None:
    assert '<p class="verdict">1 h of virtual time: 25 of 2000 deadlines' in page(
        REPORT
    )


def test_cpu_is_drawn_for_each_computer() -> None:
    found = page(REPORT)
    assert ">CPU left</text>" in found
    assert ">CPU right</text>" in found


def test_faults_and_moves_are_marked_in_turn() -> None:
    """What managers journalled is in the table, without a number and a line."""
    found = page(REPORT)
    marks = re.findall(r"<g><title>([^<]*)</title><polyline[^>]*dasharray", found)
    assert marks == [
        "right &lt;cut&gt;",
        "printer: right → left, &#x27;right&#x27; is lost",
    ]
    rows = re.findall(r"<tr><td>(\d?)</td><td>([^<]*)</td><td>([^<]*)</td>", found)
    assert rows == [
        ("1", "600.0 s", "fault"),
        ("", "604.0 s", "left"),
        ("2", "605.0 s", "manager"),
    ]


def test_a_notebook_shows_the_picture_above_the_tables() -> None:
    shown = Simulation.of(REPORT)._repr_html_()
    assert shown.index("<svg") < shown.index("<pre")


def test_outages_are_bars_at_their_time() -> None:
    """An hour takes 810 px from x = 130, so 600 s is at 265; 6.5 s would take 1.5 px.

    A bar is at least 2 px long.
    """
    found = page(REPORT)
    bar = re.search(
        r"<title>greeting: 600.0 s to 606.5 s</title><polyline points=\"([^\"]*)\"",
        found,
    )
    assert bar is not None
    assert [point.split(",")[0] for point in bar[1].split()] == ["265.0", "267.0"]


def test_late_timers_are_bars_the_worst_first() -> None:
    found = page(REPORT)
    assert found.index("20 of 1000 (2.00%)") < found.index("5 of 1000 (0.50%)")
    assert "width:2.0%" in found
    on_time = tuple(replace(each, missed=0) for each in REPORT.timers)
    assert "None was missed" in page(replace(REPORT, timers=on_time))
    assert "No timer has a deadline" in page(replace(REPORT, timers=()))


def test_a_comparison_has_the_table_and_each_placement() -> None:
    results = {each: Simulation.of(REPORT) for each in ("auto", "static")}
    found = SimulationComparison(results=results).page()
    assert found.index("<pre") < found.index("<h1>auto</h1>")
    assert found.index("<h1>auto</h1>") < found.index("<h1>static</h1>")
    assert found.count("<svg") == 2
