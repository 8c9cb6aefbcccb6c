"""What is wrong with a fault that is to be simulated. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite

from poise.model.robot import Robot
from poise.simulation.faults import KINDS, LINK_KINDS, SimulatedFault
from poise.suggest import unknown


def fault_findings(
    fault: SimulatedFault, robot: Robot, seconds: float
) -> Iterator[tuple[str, str]]:
    """Yield the wrong fields of a fault, and what is wrong with each.

    Parameters
    ----------
    seconds
        How long the simulation lasts [virtual s].
    """
    names = [each.name for each in robot.computers]
    if fault.kind not in KINDS:
        yield "kind", unknown("fault", fault.kind, KINDS)
    if not (isfinite(fault.at) and fault.at >= 0):
        yield "at", f"begins at {fault.at:g} s, before the robot is up"
    elif fault.at >= seconds:
        yield "at", f"begins at {fault.at:g} s, but {seconds:g} s are simulated"
    if not (isfinite(fault.lasts) and fault.lasts > 0):
        yield "lasts", f"lasts {fault.lasts:g} s; a fault lasts longer than 0 s"
    if not 0 <= fault.pick < 1:
        yield "pick", f"picks {fault.pick:g}, which is not in [0, 1)"
    if fault.target not in names:
        yield "target", unknown("computer", fault.target, names)
    yield from _other(fault, names)


def _other(fault: SimulatedFault, names: list[str]) -> Iterator[tuple[str, str]]:
    if fault.kind not in LINK_KINDS:
        if fault.other:
            yield "other", f"'{fault.kind}' is about one computer"
    elif fault.other not in names:
        yield "other", unknown("computer", fault.other, names)
    elif fault.other == fault.target:
        yield "other", f"a link is between two computers, not from '{fault.other}' back"
