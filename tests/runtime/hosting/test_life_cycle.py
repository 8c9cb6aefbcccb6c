"""What a component says of tasks is told apart from what it said before a crash."""

from __future__ import annotations

from poise.runtime.hosting.life_cycle import TaskNews


def test_one_that_starts_again_repeats_no_number() -> None:
    first, again = (TaskNews(lambda: None) for _ in range(2))
    for news in (first, again):
        news.note_end("done", done=True)
        news.request("start", "t")
    assert first.ends() != again.ends()
    assert first.requests() != again.requests()
