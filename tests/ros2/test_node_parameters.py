"""Which parameters of a node can be set while it runs."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from poise.clock import SystemClock
from poise.errors import UsageError
from poise.ros2.node import RosNode
from poise.runtime.component.component import Context, create, set_parameters


def node_of(answer: SimpleNamespace) -> tuple[RosNode, list[Any]]:
    """Return a node that declares two parameters, of which its file has one."""
    context = Context(
        name="talker",
        parameters={"rate": 5.0},
        devices={},
        clock=SystemClock(),
        measure=lambda *_: None,
    )
    made = create(RosNode, context)
    taken: list[Any] = []

    def take(parameters: list[Any]) -> SimpleNamespace:
        taken.extend((each.name, each.value) for each in parameters)
        return answer

    declared = {"rate": SimpleNamespace(value=5.0), "gain": SimpleNamespace(value=1.0)}
    made.__dict__["node"] = SimpleNamespace(
        _parameters=declared, set_parameters_atomically=take
    )
    return made, taken


@pytest.mark.slow
def test_what_the_node_declares_can_be_set_though_its_file_has_it_not() -> None:
    node, taken = node_of(SimpleNamespace(successful=True))
    set_parameters(node, {"gain": 2})
    assert taken == [("gain", 2.0)]
    assert node.parameters == {"rate": 5.0, "gain": 2.0}
    with pytest.raises(UsageError, match="no parameter 'gian'"):
        set_parameters(node, {"gian": 2})


@pytest.mark.slow
def test_a_wrong_type_is_called_by_its_name() -> None:
    reason = "Wrong parameter type, expected '3' got '4'"
    node, _ = node_of(SimpleNamespace(successful=False, reason=reason))
    with pytest.raises(UsageError, match="expected DOUBLE got STRING"):
        set_parameters(node, {"rate": "fast"})
