"""Runs one architecture on its rig and measures it."""

from __future__ import annotations

from collections.abc import Callable

from poise.errors import RunError
from poise.estimate.profile.profile_records import WINDOW
from poise.manage.deploy.running_components import ACTIVE_LIMIT
from poise.manage.journal import Journal
from poise.manage.observe.sample_recording import Recording
from poise.session.callbacks import Check, nothing
from poise.session.launch.start import Sampling, Started, started
from poise.session.profiling.figures import Observed, measure
from poise.session.profiling.rig import ProfilingRig

Tick = Callable[[float], None]


def measure_alone(
    rig: ProfilingRig,
    seconds: float,
    warm_up: float,
    tick: Tick,
    check: Check = nothing,
) -> Observed:
    """Return one measurement of a rig.

    Parameters
    ----------
    seconds
        Duration of the measurement [s]; > 0.
    warm_up
        Duration of the time before it [s].
    tick
        Called with the time that has passed [s].
    check
        Called several times a second; may raise to end the measurement.

    Raises
    ------
    RunError
        A component failed, or the simulator ended before the measurement did.
    """
    recording = Recording()
    sampling = Sampling(recording.add, WINDOW, weigh=True)
    journal = Journal(":memory:")
    try:
        with started(rig.robot, rig.placement, journal, nothing, sampling, check) as up:
            _watch(up, warm_up, tick)
            recording.take()
            up.computers.begin()
            _watch(up, seconds, tick)
            samples = recording.take()
            invalid = up.computers.end(rig.computer)
            working = up.run.agents.statuses()
            up.run.reach("inactive", ACTIVE_LIMIT)
            return Observed(
                measured=measure(samples),
                statuses=up.run.agents.statuses(),
                working=working,
                invalid=invalid,
            )
    finally:
        journal.close()


def _watch(up: Started, seconds: float, tick: Tick) -> None:
    if up.watch(seconds, tick):
        raise RunError(
            "the simulator ended during the measurement: name an endless one as "
            "`workload` in the robot file, or measure for a shorter time"
        )
