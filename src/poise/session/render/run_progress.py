"""Shows that a run goes on, and how."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from math import inf

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from poise.errors import PoiseError
from poise.session import nothing
from poise.session.render.simulation_tables import span
from poise.session.run import Meanwhile
from poise.session.running_robots.running import Running
from poise.session.simulate import Watch

_LINE_EVERY = 5.0
_DRAW_EVERY = 0.2


@contextlib.contextmanager
def progress(
    console: Console, seconds: float, *, live: bool = False
) -> Iterator[Meanwhile]:
    """Show how a run of up to `seconds` [s] goes; `live`: as a bar, in a terminal."""
    if not live or not console.is_terminal:
        due = _LINE_EVERY

        def tell(running: Running, now: float) -> None:
            nonlocal due
            if now >= due:
                due = now + _LINE_EVERY
                console.print(f"  {_sentence(running, now, seconds)}")

        yield tell
        return
    with _bar(console, seconds) as draw:
        yield lambda run, now: draw(now, _sentence(run, now, seconds))


@contextlib.contextmanager
def virtual_progress(
    console: Console, seconds: float, clock: Callable[[], float] = time.monotonic
) -> Iterator[Watch]:
    """Draw how a simulation of `seconds` [virtual s] goes, where it is a terminal."""
    if not console.is_terminal:
        yield nothing
        return
    before, drawn = 0.0, -inf
    began = seen = clock()

    def watch(now: float) -> None:
        nonlocal before, began, seen, drawn
        if now < before:  # the next simulation, since the last one ended
            began = seen
        before, seen = now, clock()
        if seen - drawn >= _DRAW_EVERY:
            drawn = seen
            times = now / max(seen - began, 1e-9)
            draw(now, f"{span(now)} of {span(seconds)}, {times:.3g} times real time")

    # no thread draws: while a step runs, the standard library is the simulation's
    with _bar(console, seconds, by_thread=False) as draw:
        yield watch


@contextlib.contextmanager
def _bar(
    console: Console, seconds: float, *, by_thread: bool = True
) -> Iterator[Callable[[float, str], object]]:
    """Draw a bar for some time [s], with a sentence; by a thread, or at each call."""
    columns = BarColumn(), TextColumn("{task.description}")
    with Progress(
        *columns, console=console, transient=True, auto_refresh=by_thread
    ) as bar:
        task = bar.add_task("", total=seconds)
        yield lambda now, sentence: bar.update(
            task, completed=now, description=sentence, refresh=not by_thread
        )


def _sentence(running: Running, now: float, seconds: float) -> str:
    said = f"{now:.0f} s, {max(0.0, seconds - now):.0f} s left"
    try:
        located = running.status().located()
    except PoiseError:  # it is about to end, or its manager is busy
        return said
    timers = [
        timer
        for _, component in located
        for timer in component.timers
        if timer.deadline is not None
    ]
    missed, releases = sum(t.missed for t in timers), sum(t.releases for t in timers)
    return f"{said}: {missed} of {releases} deadlines missed"
