"""What a client in ROS 2 is answered by a bridge."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, Protocol
from unittest.mock import MagicMock

import pytest

from poise import CalleeError, Message
from poise.clock import SystemClock
from poise.ros2.bridge_node import BridgeLine
from poise.ros2.service_bridges import Goals, ServesActions, ServesRos


class Answer(Message):
    success: bool
    message: str


class Switch(Protocol):
    """Sets what can be on or off."""

    def switch(self) -> Answer: ...


@pytest.mark.slow
@pytest.mark.parametrize(
    ("result", "said"),
    [
        (Answer(success=True, message="on"), "on"),
        (CalleeError("ValueError", "stuck", ""), "ValueError: stuck"),
        (Answer(success=True, message="a\0b"), "which does not fit into string"),
        (Answer(success=True, message="\udcff"), "which does not fit into string"),
        (None, "no attribute 'success'"),
    ],
)
def test_a_client_gets_an_answer_also_of_what_does_not_fit(
    result: object, said: str, caplog: pytest.LogCaptureFixture
) -> None:
    from std_srvs.srv import Trigger  # noqa: PLC0415, where it is there

    def switch() -> object:
        if isinstance(result, Exception):
            raise result
        return result

    bridge: Any = object.__new__(ServesRos)
    line = BridgeLine(ros2="/switch", type="std_srvs/srv/Trigger", method="switch")
    own = {"port": SimpleNamespace(name="light", type=Switch), "entries": [line]}
    serves: Any = type("Serves", (ServesRos,), own)
    (service,) = serves.conversions(SystemClock())
    bridge.__dict__ |= {**own, "light": SimpleNamespace(switch=switch)}
    bridge._context = SimpleNamespace(name="switch-light-ros2")
    response = bridge._serve(service, Trigger.Request(), Trigger.Response())
    assert response.success == (said == "on")
    assert said in response.message
    assert bool(caplog.text) == (said != "on")


def test_a_result_waits_for_its_client_also_over_several_moves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rclpy.serialization.deserialize_message", lambda data, _: data)
    sent: list[bytes] = []
    handle = SimpleNamespace(send_result_response=lambda _, data: sent.append(data))
    server = MagicMock(_handle=handle, _result_futures={})
    state = Goals(["0a", "0b"], {"0a": b"an", "0b": b"another"})
    for left in ({"0b": b"another"}, {}):
        bridge = object.__new__(ServesActions)
        bridge._servers = {"grip": server}
        bridge.restore(state)
        goal = state.taken[len(sent)]
        asked = SimpleNamespace(goal_id=SimpleNamespace(uuid=bytes.fromhex(goal)))
        assert bridge._give(server, None, asked)
        state = bridge.snapshot()
        assert state == Goals(["0a", "0b"], left)
    assert sent == [b"an", b"another"]
