"""The experiment's page stands alone."""

from __future__ import annotations

import io
import re
from html.parser import HTMLParser
from xml.etree import ElementTree as ET

import msgspec
from msgspec.structs import replace
from rich.console import Console

from benchmarks.experiment.page import experiment_page
from benchmarks.experiment.results import Extent, Missed, TrialResult, extents, schedule
from benchmarks.experiment.robots import ROBOTS
from benchmarks.experiment.summary import ExperimentReport, summarised
from benchmarks.experiment.tables import experiment_parts

EXTENTS = extents(ROBOTS["trot"].conditions)
SHORT = EXTENTS["quick"]
FULL = replace(EXTENTS["full"], base_seeds=10, seeds=6)


def found(
    extent: Extent, invalid: str = "", without_chains: str = ""
) -> tuple[ExperimentReport, list[TrialResult]]:
    results = [
        TrialResult(
            trial=trial,
            at=0.0,
            invalid=invalid,
            functions={"navigation": trial.arm != "static"},
            chains={}
            if trial.arm == without_chains
            else {"pose": Missed(of=10, missed=2, median=0.1, p99=0.2)},
            timers={"a.<b>": Missed(of=10, missed=1)},
            cpu_share={"main": 0.5},
            world={"path_error": 0.031, "said": "</script>"},
        )
        for trial in schedule(extent)
    ]
    arms = [each.name for each in extent.arms]
    conditions = [each.name for each in extent.conditions]
    report = ExperimentReport(
        robot="tried",
        seconds=20.0,
        planned=len(results),
        arms=summarised(results, arms, conditions, ["navigation"]),
    )
    return report, results


def page_of(extent: Extent, invalid: str = "") -> str:
    report, results = found(extent, invalid)
    return experiment_page(report, extent, results)


def pictures(page: str) -> list[ET.Element]:
    return [ET.fromstring(each) for each in re.findall("<svg.*?</svg>", page)]


def test_it_needs_no_other_file_and_has_the_raw_data() -> None:
    page = page_of(SHORT)
    HTMLParser().feed(page)
    assert not re.search(r"(src|href)=|https?:|@import", page)
    raw = page.split('id="results">')[1].split("</script>")[0].strip()
    results = [msgspec.json.decode(line, type=TrialResult) for line in raw.splitlines()]
    assert [each.trial for each in results] == schedule(SHORT)
    assert results[0].world["said"] == "</script>"
    assert "3.1 cm" in page
    assert "a.&lt;b&gt;" in page


def test_it_draws_an_interval_for_each_arm_and_function() -> None:
    (dots,) = pictures(page_of(SHORT))
    titles = [each.text for each in dots.iter("title")]
    assert titles[0] == "static: 0% (0% to 66%)"
    assert titles[1:] == [
        f"{a}: 100% (34% to 100%)" for a in ("random", "greedy", "Poise")
    ]


def test_an_arm_has_its_colour_also_where_others_have_no_line() -> None:
    report, results = found(FULL, without_chains="static")
    _, *plots = pictures(experiment_page(report, FULL, results))
    legends = [
        [(each.text, each.get("y")) for each in plot.iter("text")][-8:]
        for plot in plots
    ]
    assert legends[0] == legends[1]


def test_it_draws_where_each_arm_breaks() -> None:
    dots, works, misses = pictures(page_of(FULL))
    assert dots is not None
    for picture in (works, misses):
        lines = [
            each.get("points", "").split()
            for each in picture.iter("polyline")
            if each.get("stroke-width") == "2.5"
        ]
        assert len(lines) == len(FULL.arms)
        assert {len(points) for points in lines} == {5}


def test_without_a_valid_run_it_says_so() -> None:
    page = page_of(SHORT, invalid="this machine was too busy")
    assert "0 valid runs of 8" in page
    assert "no valid run" in page


def test_a_terminal_of_80_columns_shows_what_failed() -> None:
    report, _ = found(FULL)
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(*experiment_parts(report), sep="\n")
    lines = console.export_text().splitlines()
    assert max(map(len, lines)) <= 80
    row = r"static +0% \(0% to \d+%\) +20.0% +10 +navigation 10"
    assert any(re.match(row, line.strip()) for line in lines)
    names = {each.placement for each in report.arms}
    assert {
        name for name in names if any(line.startswith(name) for line in lines)
    } == names
