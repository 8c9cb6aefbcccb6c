"""Watching a run for starved windows."""

from __future__ import annotations

from poise.emulate import EmulatedComputer, StarvationWatch, Usage, is_starved


class Time:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.time = 0.0

    def now(self) -> float:
        """Return the time that was set."""
        return self.time

    def sleep(self, seconds: float) -> None:
        """Advance."""
        self.time += seconds


class Half(EmulatedComputer):
    """A computer of half a core, whose usage is set by hand."""

    def __init__(self) -> None:
        self.used = self.starved = 0.0

    def usage(self) -> Usage:
        """Return what was set."""
        return Usage(used=self.used, starved=self.starved)

    def was_starved(self, before: Usage, after: Usage) -> bool:
        """Return the real judgement."""
        return is_starved(before, after, 0.5)


def test_short_starvation_is_not_lost_in_a_long_run() -> None:
    clock, busy, calm = Time(), Half(), Half()
    watch = StarvationWatch({"busy": busy, "calm": calm}, clock)
    for second in range(60):
        clock.sleep(1.0)
        busy.used += 0.4
        calm.used += 0.4
        # In one second of sixty it got 0.4 s and waited for 0.6 s.
        busy.starved += 0.6 if second == 30 else 0.0
        watch.poll()
    assert watch.end() == {"busy": 1.0}
    assert not busy.was_starved(Usage(used=0.0, starved=0.0), busy.usage())


def test_windows_are_not_judged_before_they_are_over() -> None:
    clock, computer = Time(), Half()
    watch = StarvationWatch({"only": computer}, clock)
    clock.sleep(0.5)
    computer.starved += 0.1  # nothing used yet: starved, if this were a window
    watch.poll()
    clock.sleep(0.5)
    computer.used += 0.4  # 0.4 / (0.4 + 0.1) = 0.8 of a CPU
    watch.poll()
    assert watch.end() == {}


def test_last_window_counts_though_it_is_short() -> None:
    clock, computer = Time(), Half()
    watch = StarvationWatch({"only": computer}, clock)
    clock.sleep(0.25)
    computer.starved += 0.25
    assert watch.end() == {"only": 0.25}
    assert watch.end() == {"only": 0.25}
