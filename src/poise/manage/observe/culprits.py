"""Names what takes the CPU that others on its computer lack. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from poise.manage.observe.estimates import DemandEstimate
from poise.manage.observe.loads import Load
from poise.units import format_cores

_LEAST = 0.05
"""What takes less than this beyond its demand [cores] is no culprit."""


def culprit_on(
    load: Load | None, demand_estimates: Iterable[DemandEstimate], victim: str = ""
) -> str:
    """Return what takes most beyond what was expected on a computer, for people.

    Parameters
    ----------
    load
        The computer's; None: it is not known.
    victim
        A component that lacks CPU, and is not the culprit itself.

    Returns
    -------
    Empty: nothing takes more than was expected of it.
    """
    if load is None:
        return ""
    usual = {each.component: each.usual for each in demand_estimates}
    excesses = {
        name: used - usual.get(name, 0.0)
        for name, used in load.components.items()
        if name != victim
    }
    worst = max(excesses, key=excesses.__getitem__, default="")
    excess = excesses.get(worst, 0.0)
    if max(excess, load.background) < _LEAST:
        return ""
    if load.background > excess:
        return f"other programs take {format_cores(load.background)} there"
    instead = f" instead of {format_cores(usual[worst])}" if usual.get(worst) else ""
    used = format_cores(load.components[worst])
    return f"component '{worst}' takes {used} there{instead}"
