"""What still runs after the end of a lease, so far as its container says."""

from __future__ import annotations

from unittest.mock import Mock

from poise.runtime.supervision.container_processes import ContainerProcess
from poise.wire.records.deployment_records import ComponentSpec, ContainerSpec
from poise.wire.records.status_records import ComponentStatus, ContainerStatus

LEASED = ComponentSpec(name="arm", epoch=2, goal="inactive", leased=True)
PINNED = ComponentSpec(name="eye", goal="active")


def said(at: float, **states: str) -> ContainerStatus:
    components = tuple(
        ComponentStatus(name=name, epoch=2 * (name == "arm"), state=state)  # type: ignore[arg-type]
        for name, state in states.items()
    )
    return ContainerStatus(name="one", pid=7, at=at, components=components)


def test_only_what_was_said_since_then_of_what_is_leased_counts() -> None:
    spec = ContainerSpec(
        name="one", folder="", components=(LEASED, PINNED), connectors=()
    )
    process = ContainerProcess(spec, Mock())
    assert process.leased_at_work(10.0) == []
    process.status = said(9.9, arm="active", eye="active")
    assert process.leased_at_work(10.0) == []  # it is starved or stopped
    process.status = said(10.1, arm="active", eye="active")
    assert process.leased_at_work(10.0) == ["arm"]
    process.status = said(10.2, arm="inactive", eye="active")
    assert process.leased_at_work(10.0) == []
