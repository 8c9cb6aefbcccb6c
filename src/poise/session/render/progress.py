"""Shows that a run goes on, and how."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from poise.manage.agent_connections.statuses import components_of
from poise.manage.deploy.running_components import RunningComponents
from poise.session.run import Meanwhile

_LINE_EVERY = 5.0


@contextlib.contextmanager
def progress(
    console: Console, seconds: float, *, live: bool = False
) -> Iterator[Meanwhile]:
    """Tell how a run of up to `seconds` [s] goes, each time that it is called.

    Parameters
    ----------
    live
        Draw a bar where the console is a terminal. Only where components print
        nothing, or their lines and the bar end up in each other.
    """
    if not live or not console.is_terminal:
        due = _LINE_EVERY

        def tell(run: RunningComponents, now: float) -> None:
            nonlocal due
            if now >= due:
                due = now + _LINE_EVERY
                console.print(f"  {_sentence(run, now, seconds)}")

        yield tell
        return
    columns = BarColumn(), TextColumn("{task.description}")
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=seconds)
        yield lambda run, now: bar.update(
            task, completed=now, description=_sentence(run, now, seconds)
        )


def _sentence(run: RunningComponents, now: float, seconds: float) -> str:
    timers = [
        timer
        for component in components_of(run.agents.statuses())
        for timer in component.timers
        if timer.deadline is not None
    ]
    missed, releases = sum(t.missed for t in timers), sum(t.releases for t in timers)
    left = max(0.0, seconds - now)
    return f"{now:.0f} s, {left:.0f} s left: {missed} of {releases} deadlines missed"
