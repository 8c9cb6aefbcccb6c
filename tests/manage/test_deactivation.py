"""What was sent and neither processed nor refused."""

from __future__ import annotations

from poise.manage.deactivation import _left
from poise.wire.records.status import ConnectorStatus, Summary


def ends(processed: int, errors: int) -> list[ConnectorStatus]:
    """Return both ends of a connector over which five messages were sent."""
    source = ConnectorStatus(
        name="a.out-b.in", kind="local", end="source", ready=True, messages=5
    )
    target = ConnectorStatus(
        name="a.out-b.in",
        kind="local",
        end="target",
        ready=True,
        messages=5,
        errors=errors,
        wait=Summary(count=processed),
    )
    return [source, target]


def test_a_refused_message_is_not_lost() -> None:
    assert _left(ends(processed=3, errors=2)) == 0


def test_what_was_not_processed_is_left() -> None:
    assert _left(ends(processed=3, errors=0)) == 2
