"""Checks of a robot whose file is well formed; pure."""

from __future__ import annotations

from collections.abc import Iterator

from poise.model.check.allowed_computers import (
    check_allowed_computers,
    check_checkpoints,
    check_demands,
    check_together_apart,
)
from poise.model.check.connectors import (
    check_chains,
    check_connectors,
    check_ports,
    declared_ports,
)
from poise.model.check.names import check_addresses, check_names
from poise.model.check.task_checks import (
    check_ends,
    check_policies,
    check_tasks,
    check_workload,
)
from poise.model.repository import Repository
from poise.model.robot import Robot
from poise.model.yaml.tree import Finding


def check(robot: Robot, repository: Repository) -> Iterator[Finding]:
    """Yield every problem of `robot` that shows without its code.

    Parameters
    ----------
    repository
        Where functions were looked for that the robot file does not provide.
    """
    yield from check_names(robot)
    yield from check_addresses(robot)
    yield from check_allowed_computers(robot)
    yield from check_checkpoints(robot)
    yield from check_demands(robot)
    yield from check_together_apart(robot)
    yield from check_connectors(robot)
    yield from check_chains(robot)
    yield from check_ports(robot, declared_ports(robot))
    yield from check_workload(robot)
    yield from check_policies(robot)
    yield from check_tasks(robot, repository)
    yield from check_ends(robot, declared_ports(robot))
