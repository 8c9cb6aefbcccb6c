"""What is drawn while a simulation runs."""

from __future__ import annotations

import io
import threading
from collections.abc import Sequence

from rich.console import Console

from poise.session.render.run_progress import virtual_progress


def drawn(moments: Sequence[float], clock: Sequence[float], *, tty: bool) -> str:
    """Return what is drawn last when virtual time is at moments.

    Parameters
    ----------
    clock
        Real time, each time that it is asked [s].
    """
    out = io.StringIO()
    console = Console(file=out, force_terminal=tty, width=100, color_system=None)
    with virtual_progress(console, 3600.0, iter(clock).__next__) as watch:
        for moment in moments:
            watch(moment)
    return out.getvalue()


def test_virtual_time_is_compared_with_real_time() -> None:
    """A minute and a half in 3 s is 30 times real time."""
    said = drawn([90.0], [10.0, 13.0], tty=True)
    assert "1 min 30 s of 1 h, 30 times real time" in said


def test_the_next_simulation_begins_anew() -> None:
    """It began when the one before ended, after 8 s: 1 s in 0.5 s."""
    said = drawn([600.0, 1.0], [0.0, 8.0, 8.5], tty=True)
    assert "1 s of 1 h, 2 times real time" in said


def test_it_is_drawn_a_few_times_a_second_and_by_no_thread() -> None:
    """While a step runs, the standard library is the simulation's."""
    threads = threading.active_count()
    out = io.StringIO()
    console = Console(file=out, force_terminal=True, width=100, color_system=None)
    clock = iter([0.0, 1.0, 1.1, 1.25])
    with virtual_progress(console, 60.0, clock.__next__) as watch:
        for moment in (1.0, 2.0, 3.0):
            watch(moment)
        assert threading.active_count() == threads
    assert "1 s of 1 min" in out.getvalue()
    assert "2 s of 1 min" not in out.getvalue()
    assert "3 s of 1 min" in out.getvalue()


def test_nothing_is_drawn_where_no_terminal_is() -> None:
    assert drawn([60.0], [], tty=False) == ""
