"""Which components are pinned to their computers, and which are leased. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from poise.model.check.allowed_computers import allowed_computers
from poise.model.robot import Robot


def pinned_components(robot: Robot) -> Mapping[str, str]:
    """Return component -> why it stays on its computer, of those that do."""
    allowed = allowed_computers(robot)
    pinned = {}
    for architecture in robot.architectures:
        for component in architecture.components:
            choices = sorted(allowed[component.name])
            if architecture.layer != "sequencing":
                why = f"it belongs to the {architecture.layer} layer, which stays"
            elif not component.movable:
                why = "it is not movable (robot file)"
            elif len(choices) < 2:  # noqa: PLR2004
                why = f"it may run on {' or '.join(choices)} only"
            else:
                continue
            pinned[component.name] = why
    return pinned


def leased_components(robot: Robot) -> frozenset[str]:
    """Return the components that are inactive while their computer is cut off."""
    pinned = pinned_components(robot)
    return frozenset(
        component.name
        for component in robot.components()
        if component.name not in pinned
        and (component.when_cut_off or robot.when_cut_off) == "stop"
    )
