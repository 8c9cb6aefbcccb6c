"""The links of a robot file, as the simulator has them."""

from __future__ import annotations

from collections.abc import Mapping

from poise.model.robot import Robot
from poise.simulation.network.network import LinkModel

_JITTER = 0.25
"""Mean of what comes on top of a link's latency, as a share of that."""


def links_of(robot: Robot) -> Mapping[frozenset[str], LinkModel]:
    """Return pairs of computers -> their links; what a file leaves out is as usual."""
    usual = LinkModel()
    return {
        frozenset(link.between): LinkModel(
            latency=link.latency or usual.latency,
            jitter=(link.latency or usual.latency) * _JITTER,
            bandwidth=link.bandwidth or usual.bandwidth,
        )
        for link in robot.links
    }
