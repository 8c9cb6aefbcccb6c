"""A robot in virtual time, for a user who asks what will happen."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from poise.estimate.profile import Profile
from poise.model.robot import Robot
from poise.simulation.faults import SimulatedFault
from poise.simulation.report import SimulationReport


class RehearsalPlan(Struct, frozen=True, kw_only=True):
    """What is simulated, but for the seed.

    Parameters
    ----------
    placement
        Component -> computer, at first.
    method
        What decided that.
    profile
        Of the robot; None: nothing was measured.
    faults
        What breaks; `at` counts from the moment when the robot is up [s].
    adapts
        Whether Poise changes the placement by itself.
    seconds
        How long it is to last [virtual s].
    """

    robot: Robot
    placement: Mapping[str, str]
    method: str
    tasks: tuple[str, ...]
    profile: Profile | None = None
    faults: tuple[SimulatedFault, ...] = ()
    adapts: bool = True
    seconds: float = 60.0


class Rehearsal:
    """A robot in virtual time, for a user who asks what will happen."""

    now: float
    """Virtual time since the robot was up [s]."""

    def __init__(self, scenario: RehearsalPlan, seed: int = 0) -> None:
        raise NotImplementedError

    def come_up(self) -> None:
        """Start the robot; RunError when it does not come up."""
        raise NotImplementedError

    def advance(self, seconds: float) -> None:
        """Let virtual time [s] pass."""
        raise NotImplementedError

    def report(self) -> SimulationReport:
        """Return what is known so far; any time after `come_up`."""
        raise NotImplementedError

    def close(self) -> None:
        """End all that it simulates."""
        raise NotImplementedError
