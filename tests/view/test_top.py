"""`poise top` in a terminal of 80 x 24, driven by keys."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest
from msgspec.structs import replace

from poise.errors import RunError
from poise.manage.observe.deviations import Deviation
from poise.session.running_robots.running import JournalEntry, Status
from tests.view.test_robot_view import seen

pytest.importorskip("textual")
pytestmark = pytest.mark.slow

SIZE = (80, 24)


def status() -> Status:
    return replace(
        seen(10.0, cpu=1.0, missed=5, sent=100),
        deviations=tuple(
            Deviation(what=what, computer="right", since=0.0)
            for what in ("computer 'right' is out of reach", "another")
        ),
        recent=(
            JournalEntry(0.0, "decided", "balance, 2 moves", None),
            JournalEntry(0.0, "failed", "it did not help", None),
        ),
    )


def drive(
    read: Callable[[], Any], keys: str, look: Callable[[Any], None], turns: int = 1
) -> str:
    """Press keys, look at the app, and return the screen as text."""
    from poise.view.top import Top  # noqa: PLC0415, needs textual

    async def run() -> str:
        app = Top(read, every=3600.0)
        async with app.run_test(size=SIZE) as pilot:
            for turn in range(turns):
                if turn:
                    app._poll()
                await app.workers.wait_for_complete()
                await pilot.pause()
            await pilot.press(*keys)
            await pilot.pause()
            look(app)
            return "\n".join(
                "".join(segment.text for segment in strip)
                for strip in app.screen._compositor.render_strips()
            )

    return asyncio.run(run())


def column(app: Any, table: str, number: int) -> list[str]:
    found = app.query_one(f"#{table}")
    return [str(found.get_row_at(i)[number]) for i in range(found.row_count)]


def test_all_is_on_one_screen() -> None:
    screen = drive(status, "", lambda _: None)
    lines = screen.split("\n")
    assert len(lines) == SIZE[1]
    said = "robot 'r', task 'work': not known: right; computer 'right' is out of reach"
    assert said in screen
    assert "0.50/2" in screen
    assert "out of reach" in screen
    assert "eye.x-mind.x" in screen
    assert "not there" in screen
    assert "balance, 2 moves" in screen
    assert "q quit" in screen


def test_long_names_leave_room_for_the_other_columns() -> None:
    from poise.view.top import _fitting  # noqa: PLC0415, needs textual

    name = "a_very_long_component.with_a_port-another_component.port"
    (short,) = _fitting([(name, "local", "3.0")], ["connector", "kind", "rate/s"], 60)
    assert short == ("a_very_long_compone…ther_component.port", "local", "3.0")
    (whole,) = _fitting([(name, "local")], ["connector", "kind"], 80)
    assert whole == (name, "local")


def test_keys_sort_the_table_in_focus() -> None:
    def by_name(app: Any) -> None:
        assert column(app, "components", 0) == ["eye", "mind"]

    def turned(app: Any) -> None:
        assert column(app, "components", 0) == ["mind", "eye"]

    def by_state(app: Any) -> None:
        assert column(app, "components", 2) == ["active", "not there"]
        assert "state ▲" in [
            str(c.label) for c in app.query_one("#components").columns.values()
        ]

    drive(status, "", by_name)
    drive(status, "r", turned)
    drive(status, "ss", by_state)


def test_a_manager_that_is_silent_is_said_and_asked_again() -> None:
    answers: list[Any] = [RunError("robot 'r' gave no answer"), status()]

    def read() -> Any:
        answer = answers.pop(0) if len(answers) > 1 else answers[0]
        if isinstance(answer, Exception):
            raise answer
        return answer

    assert "robot 'r', task 'work'" in drive(read, "", lambda _: None, turns=2)

    def never() -> Any:
        raise RunError("robot 'r' gave no answer")

    assert "no answer: robot 'r' gave" in drive(never, "", lambda _: None)

    ends: list[Any] = [status()]
    screen = drive(lambda: ends.pop() if ends else never(), "", lambda _: None, turns=2)
    assert "no answer, below is what was known last: robot 'r' gave" in screen
    assert "eye" in screen


def test_q_quits() -> None:
    drive(status, "q", lambda _: None)
