"""ROS 2: a service; its request is empty, its answer carries the payload as text."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from std_srvs.srv import Trigger

from benchmarks.calls.ros import start
from benchmarks.calls.timing import Trips, timed


def serve(_folder: Path, ready: Callable[[], None]) -> None:
    """Answer with the payload that the client asked for by the service's name."""
    node = start("server")

    def answering(text: str) -> Callable[[Any, Any], Any]:
        def answer(_request: Any, response: Any) -> Any:
            response.message = text
            return response

        return answer

    for size in (64, 4096, 1 << 20, 6 << 20):
        node.create_service(Trigger, f"echo_{size}", answering("x" * size))
    ready()
    rclpy.spin(node)


@contextmanager
def connect(_folder: Path) -> Iterator[Trips]:
    """Give the round trips."""
    node = start("client")

    def trips(size: int, count: int) -> list[float]:
        client = node.create_client(Trigger, f"echo_{size}")
        assert client.wait_for_service(20.0)

        def echo(request: Any) -> None:
            rclpy.spin_until_future_complete(node, client.call_async(request))

        return timed(echo, Trigger.Request(), count)

    yield trips
