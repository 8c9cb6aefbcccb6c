"""What a person does on a page, without a browser."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from unittest.mock import MagicMock

import pytest

from poise.errors import RunError
from poise.view.dashboard import dialogs
from poise.view.dashboard.dialogs import PageActions

pytestmark = pytest.mark.slow


class Button(MagicMock):
    """A button as NiceGUI's: it is enabled or not."""

    enabled = True

    def disable(self) -> None:
        self.enabled = False

    def enable(self) -> None:
        self.enabled = True


@pytest.fixture
def moves() -> list[tuple[str, str]]:
    return []


@pytest.fixture
def page(monkeypatch: pytest.MonkeyPatch, moves: list[tuple[str, str]]) -> PageActions:
    """Return a page that has moved two components from `left`; `b` stays."""

    async def io_bound(do: Callable[[], str]) -> str:
        await asyncio.sleep(0)
        return do()

    def move(component: str, computer: str, *, force: bool) -> str:
        assert force
        moves.append((component, computer))
        if component == "b" and len(moves) == 1:
            raise RunError("the move of 'b' was refused")
        return "a report"

    monkeypatch.setattr(dialogs, "ui", MagicMock(button=Button()))
    monkeypatch.setattr(dialogs, "run", MagicMock(io_bound=io_bound))
    monkeypatch.setattr(dialogs, "outcome_sentence", str)
    actions = PageActions(MagicMock(move=move))
    actions.place_undo()
    actions._undo += [("a", "left"), ("b", "left")]
    return actions


async def click_twice(page: PageActions) -> None:
    await asyncio.gather(page._undo_last(), page._undo_last())


def test_an_undo_that_is_refused_may_be_tried_again_and_two_clicks_undo_one_move(
    page: PageActions, moves: list[tuple[str, str]]
) -> None:
    asyncio.run(click_twice(page))
    assert (moves, len(page._undo)) == ([("b", "left")], 2)
    page._button.set_visibility.assert_called_with(True)
    for _ in range(2):
        asyncio.run(click_twice(page))
    assert moves[1:] == [("b", "left"), ("a", "left")]
    page._button.set_visibility.assert_called_with(False)
