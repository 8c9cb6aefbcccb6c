"""Which subscribed ports got no message, and why."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from poise.manage.deployment import name_of
from poise.manage.statuses import components_of, connectors_of
from poise.model.robot import Connector, Robot
from poise.wire.records.deployment import AgentStatus


class SilentPort(Struct, frozen=True, kw_only=True):
    """A subscribed port that got no message.

    Parameters
    ----------
    port
        As component.port.
    reason
        Why, so far as it is known, for people.
    """

    port: str
    reason: str

    def __str__(self) -> str:
        """Return it as a sentence."""
        return f"port {self.port} got no message: {self.reason}"


def silent_ports(
    robot: Robot, statuses: Mapping[str, AgentStatus]
) -> tuple[SilentPort, ...]:
    """Return the subscribed ports to which no message came since the start."""
    running = {component.name for component in components_of(statuses)}
    came: dict[str, int] = {}
    sent: dict[str, int] = {}
    for end in connectors_of(statuses):
        if end.end != "source":
            came[end.name] = came.get(end.name, 0) + end.messages
        if end.end != "target":
            sent[end.name] = max(sent.get(end.name, 0), end.messages)
    found = []
    for component in components_of(statuses):
        for port in component.subscribes:
            name = f"{component.name}.{port}"
            leads = [c for c in robot.all_connectors() if str(c.between[1]) == name]
            if not any(came.get(name_of(connector)) for connector in leads):
                reasons = [_reason(connector, running, sent) for connector in leads]
                reason = "; ".join(reasons) or "no connector leads to it"
                found.append(SilentPort(port=name, reason=reason))
    return tuple(found)


def _reason(connector: Connector, running: set[str], sent: Mapping[str, int]) -> str:
    source = connector.between[0]
    if source.component not in running:
        return f"component '{source.component}', which publishes to it, does not run"
    count = sent.get(name_of(connector), 0)
    if not count:
        return f"{source} published nothing"
    return f"{source} published {count}, and none arrived"
