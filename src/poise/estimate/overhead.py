"""The cost of a connector whose ends are on different computers.

::

    overhead = 100 * (load(remote) - load(together))           [hundredths of a core]
    load(kind) = call * calls/s + message * messages/s + byte * bytes/s       [cores]

`call` and `message` [s] and `byte` [s/byte] are CPU times of both ends, measured for
each kind of connector on these computers (`poise calibrate`). `together` is the
connector's kind when both ends are on one computer: direct within a container, local
between two. So the overhead matrix (paper, section III) is CPU that could be saved.

Without measured costs the overhead is the traffic [MB/s].
"""

from __future__ import annotations

from collections.abc import Mapping

from poise.estimate.profile import ConnectorProfile, KindCosts, Profile
from poise.model.robot import ComponentEntry, Connector, Robot

_HUNDREDTHS = 100
_MEGABYTE = 1e6


def overhead_of(
    connector: ConnectorProfile, together: str, costs: Mapping[str, KindCosts]
) -> float:
    """Return the relative overhead of a connector, >= 0; `costs` is by its kind."""
    if "remote" not in costs:
        return connector.traffic / _MEGABYTE
    less = costs.get(together, KindCosts()).load(connector)
    return _HUNDREDTHS * max(0.0, costs["remote"].load(connector) - less)


def overheads(robot: Robot, profile: Profile) -> dict[str, float]:
    """Return the relative overhead of each measured connector."""
    kinds = kinds_together(robot)
    return {
        name: overhead_of(each, kinds[name], profile.costs)
        for name, each in profile.connectors.items()
        if name in kinds
    }


def kinds_together(robot: Robot) -> dict[str, str]:
    """Return connector -> its kind when both ends are on one computer.

    The components of one architecture share a container, unless one is isolated or a
    command.
    """
    found = {str(connector): "local" for connector in robot.connectors}
    for architecture in robot.architectures:
        alone = {c.name for c in architecture.components if _is_alone(c)}
        for connector in architecture.connectors:
            ends = {end.component for end in connector.between}
            found[str(connector)] = "local" if ends & alone else "direct"
    return found


def declared(connector: Connector) -> ConnectorProfile:
    """Return the traffic in the robot file, which does not distinguish calls."""
    return ConnectorProfile(messages=connector.rate, size=connector.message)


def _is_alone(component: ComponentEntry) -> bool:
    return component.isolated or bool(component.command)
