"""A run's report as a page, and the pictures that notebooks show."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from msgspec.structs import replace

import poise
from poise.manage.journal import JournalEntry
from poise.manage.observe.deviations import LocatedFault
from poise.model import load
from poise.model.robot import Computer, Robot
from poise.session.render.report_page import Mark, over_time
from poise.session.run_records import MOST, ComponentReport, History, Moment
from poise.session.run_report import RunReport
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ContainerStatus,
    Summary,
    TimerStatus,
)

HELLO = Path(__file__).parents[4] / "examples/hello/robot.yaml"
LEFT = Computer(name="left", capacity={"cpu": 1.0, "memory": 2**30})
ROBOT = Robot(name="r", computers=(LEFT,))


def timer(releases: int, missed: int) -> TimerStatus:
    return TimerStatus(
        name="tick",
        period=0.1,
        deadline=0.1,
        releases=releases,
        missed=missed,
        lateness=Summary(),
        duration=Summary(p99=0.3),
    )


def status(uptime: float, cpu: float, releases: int, missed: int) -> AgentStatus:
    eye = ComponentStatus(name="eye", state="active", timers=(timer(releases, missed),))
    container = ContainerStatus(name="see", pid=1, components=(eye,))
    return AgentStatus(
        computer="left", generation=1, uptime=uptime, cpu=cpu, containers=(container,)
    )


REPORT = RunReport(
    robot="r",
    task="work",
    method="auto",
    placement={"eye": "left"},
    decision_seconds=0.0,
    seconds=20.0,
    cpu_share={"left": 1.25},
    components=(
        ComponentReport(
            name="eye",
            computer="left",
            cpu=0.5,
            errors=0,
            timers=(timer(100, 30),),
            measures={},
        ),
    ),
    connectors=(),
    began=1000.0,
    faults=(
        LocatedFault(
            computer="left", container="see", message="container 'see' ended", at=1004.1
        ),
    ),
    history=(
        Moment(at=1005.0, cpu_share={"left": 0.5}, missed={"eye.tick": 0.1}),
        Moment(at=1006.0, cpu_share={"left": 0.96}, missed={"eye.tick": 0.4, "z": 0.2}),
    ),
    journal=(
        JournalEntry(999.0, "decided", "before <it> began", {}),
        JournalEntry(1005.5, "wrong", "a load came", {}),
        JournalEntry(1019.0, "seen", "much later", {}),
    ),
)


def worst(page: str) -> str:
    """Return the part of the page on missed deadlines."""
    return page.partition("Worst deadlines")[2].partition("<h2>")[0]


def test_the_page_says_what_happened_around_the_worst_second() -> None:
    found = worst(REPORT.page())
    for words in ("eye.tick, left", "30 of 100 (30.0%)", "300 ms of 100 ms"):
        assert words in found
    assert "6 s: 40% in a second" in found
    assert "CPU: left 96% (overloaded)" in found
    assert "late as well: z" in found
    # the second began at 1005; so 1004 to 1007 is around it
    assert "#2 container &#x27;see&#x27; ended" in found
    assert "#3 a load came" in found
    assert "much later" not in found
    quick = replace(REPORT.components[0], timers=(timer(100, 0),))
    assert "None was missed" in worst(replace(REPORT, components=(quick,)).page())


def test_what_was_never_due_counts_as_nothing_that_was_kept() -> None:
    idle = replace(REPORT.components[0], timers=(timer(0, 0),))
    assert "Nothing is known of eye.tick" in worst(
        replace(REPORT, components=(idle,)).page()
    )
    assert "Nothing is known" not in worst(REPORT.page())


def test_no_figure_is_shown_of_a_timer_that_was_never_due() -> None:
    row = next(line for line in str(REPORT).splitlines() if "tick" in line)
    assert "30.0%" in row
    idle = replace(REPORT.components[0], timers=(timer(0, 0),))
    said = str(replace(REPORT, components=(idle,)))
    row = next(line for line in said.splitlines() if "tick" in line)
    assert row.split() == ["eye", "50.0%", "tick", "100", "ms"]


def luminance(colour: str) -> float:
    """Return a colour's relative luminance, as WCAG 2 has it."""
    parts = [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    red, green, blue = (
        part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4
        for part in parts
    )
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def test_what_is_wrong_can_be_read_on_light_and_dark_pages() -> None:
    colours = re.findall(r"(?<!-)color: (#\w{6})", REPORT.html())
    assert colours
    for colour in colours:
        light = luminance(colour)
        assert 1.05 / (light + 0.05) >= 4  # on white
        assert (light + 0.05) / 0.056 >= 4  # on #121212, of a browser's dark page


class Tags(HTMLParser):
    """Collects what a page loads, and the tags that are not closed."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.open: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.loads += [n for n, _ in attrs if n in {"src", "href", "xlink:href"}]
        self.loads += [tag] if tag in {"script", "link", "iframe"} else []
        self.open += [tag] if tag != "meta" else []

    def handle_startendtag(self, tag: str, attrs: object) -> None:
        """Take a tag that closes itself."""

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_the_page_stands_alone_and_takes_no_text_for_tags() -> None:
    page = REPORT.page()
    tags = Tags(page.replace("<br>", ""))
    assert tags.loads == []
    assert tags.open == []
    assert "url(" not in page
    assert "before &lt;it&gt; began" in page


def test_entries_from_before_the_run_are_not_on_the_time_line() -> None:
    (drawing,) = re.findall(r"<svg.*?</svg>", REPORT.page(), re.DOTALL)
    titles = re.findall(r"<title>(.*?)</title>", drawing)
    assert [title.split(" ", 1)[1] for title in titles] == [
        "container &#x27;see&#x27; ended",
        "a load came",
        "much later",
    ]


def test_numbers_that_would_overlap_are_joined() -> None:
    moments = (10.0, 50.0, 50.1, 50.4, 60.0, 99.9, 100.0)
    marks = {n: Mark(at, "it moved") for n, at in enumerate(moments, 8)}
    drawing = over_time({}, marks, 100.0, "what happened")
    numbers = re.findall(r'<text x="([\d.]+)" y="11.0" font-size="10">(.*?)<', drawing)
    assert [number for _, number in numbers] == ["8", "9-11", "12", "13-14"]
    assert float(numbers[-1][0]) <= 960 - 5 * 6  # all of it is in the picture


def test_a_run_shorter_than_a_moment_shows_its_computers() -> None:
    """The CPU of `left` is that of the whole run, and of `right` none was heard."""
    (eye,) = REPORT.components
    hand = replace(eye, name="hand", computer="right")
    page = replace(REPORT, components=(eye, hand), history=(), seconds=0.3).page()
    ran, _, over_time = page.partition("<h2>Over time</h2>")
    for words in ("<span>left</span><span>CPU 125%", "<span>right</span><span>CPU not"):
        assert words in ran
    drawing = over_time.partition("</svg>")[0]
    for words in ("CPU left<", "CPU right<"):
        assert words in drawing
    assert drawing.count('stroke="#3b7dd8"') == 1


@pytest.mark.parametrize(
    ("change", "verdict"),
    [
        ({"faults": ()}, "30 deadlines missed"),
        ({"faults": (), "interrupted": True}, "without a fault, and was ended early"),
        ({"faults": (), "components": ()}, "nothing has a deadline"),
        ({"refused": {"x": 1}}, "failed"),
        ({"invalid": "too busy"}, "invalid run: too busy"),
    ],
)
def test_the_verdict_comes_first(change: dict[str, object], verdict: str) -> None:
    page = replace(REPORT, **change).page()
    assert verdict in page.partition("<h2>")[0]


def test_a_moment_is_taken_every_second() -> None:
    history = History(ROBOT, {})
    for step in range(16):
        now = step / 5
        statuses = {"left": status(10 + now, now / 2, step, step // 2)}
        history.record(statuses, 1000 + now, now)
    assert [m.at for m in history.moments] == [1000.0, 1001.0, 1002.0, 1003.0]
    assert [m.cpu_share for m in history.moments[1:]] == [{"left": 0.5}] * 3
    assert history.moments[0].missed == {}
    assert history.moments[2].missed == {"eye.tick": pytest.approx(0.6, abs=0.15)}


def test_a_long_run_has_fewer_moments_per_second() -> None:
    history = History(ROBOT, {})
    for second in range(3 * MOST):
        history.record({}, 1000.0 + second, float(second))
    assert MOST / 2 <= len(history.moments) <= MOST
    assert history.moments[-1].at >= 1000 + 3 * MOST - 4


def test_notebooks_show_pictures() -> None:
    robot = load(HELLO)
    placed = poise.place(robot, "greet")
    for shown in (placed._repr_html_(), REPORT._repr_html_()):
        assert shown.startswith("<div>")
        assert "<pre" in shown
    assert "counter" in placed.picture()
    assert "▲" in REPORT.picture()  # not by colour alone


def test_a_notebook_shows_a_robot_as_a_diagram() -> None:
    robot = load(HELLO)
    assert callable(poise.load)  # where robots of notebooks come from
    show = vars(Robot)["_repr_html_"]  # as Jupyter finds it
    assert "<svg" in show(robot)
