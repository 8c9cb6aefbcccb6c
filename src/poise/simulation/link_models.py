"""How the links of a robot behave in a simulation."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite

from msgspec import Struct

from poise.model.robot import Robot
from poise.simulation._engine import Engine

_JITTER = 0.25
"""Mean of what comes on top of a link's latency, as a share of that."""


class LinkModel(Struct, frozen=True, kw_only=True):
    """How a link behaves while nothing is wrong with it.

    `latency`, `jitter`: one way [s]; jitter is the mean of what comes on top,
    exponentially.
    `bandwidth`: [bytes/s]
    """

    latency: float = 200e-6
    jitter: float = 50e-6
    bandwidth: float = 12.5e6


def links_of(robot: Robot) -> Mapping[frozenset[str], LinkModel]:
    """Return pairs of computers -> their links; what a file leaves out is as usual."""
    usual = LinkModel()
    return {
        frozenset(link.between): LinkModel(
            latency=link.latency or usual.latency,
            jitter=(link.latency or usual.latency) * _JITTER,
            bandwidth=link.bandwidth if isfinite(link.bandwidth) else usual.bandwidth,
        )
        for link in robot.links
    }


def set_links(
    engine: Engine,
    links: Mapping[frozenset[str], LinkModel],
    usual: LinkModel = LinkModel(),  # noqa: B008, it is frozen
) -> None:
    """Let an engine have links; those that are not named are as usual."""
    engine.set_usual_link(usual.latency, usual.jitter, usual.bandwidth)
    for pair, link in links.items():
        one, other = sorted(pair)
        for way in ((one, other), (other, one)):
            engine.set_link(*way, link.latency, link.jitter, link.bandwidth)
