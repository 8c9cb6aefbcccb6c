"""Actions: a provided method is offered to ROS 2, a required one is a goal there."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import msgspec

from poise.errors import CallError, RunError, Timeout, Unavailable
from poise.ros2.service_bridges import LONGEST, AsksRos, Service, Services
from poise.runtime.component.component import time_left
from poise.runtime.component.started_calls import MOST_OPEN, StartedCall


class ServesActions(Services):
    """Calls the port for the goals of clients in ROS 2, without waiting for it."""

    def open(self) -> None:
        """Offer nothing yet: the incarnation before does."""
        self._servers: dict[str, Any] = {}
        self._calls: dict[bytes, StartedCall[Any]] = {}

    def listen(self) -> None:
        """Offer the actions from now on."""
        from rclpy.action import ActionServer, GoalResponse  # noqa: PLC0415, only where a node runs

        def accept(_: object) -> GoalResponse:
            has_room = len(self._calls) < MOST_OPEN
            return GoalResponse.ACCEPT if has_room else GoalResponse.REJECT

        services = self.conversions(self.clock)
        for entry, service in zip(self.entries, services, strict=True):
            if service.name not in self._servers:
                self._servers[service.name] = ActionServer(
                    self.node,
                    service.kind,
                    entry.ros2,
                    lambda _: None,
                    goal_callback=accept,
                    handle_accepted_callback=partial(self._begin, service),
                    cancel_callback=partial(self._cancel, service),
                )
        super().listen()

    def _begin(self, service: Service, goal: Any) -> None:  # noqa: ANN401, a goal of rclpy
        from rclpy.action.server import GoalEvent  # noqa: PLC0415, only where a node runs

        method = getattr(getattr(self, self.port.name), service.name)
        # `execute` would run the rest at once
        goal._update_state(GoalEvent.EXECUTE)  # noqa: SLF001
        try:
            request = service.request.from_ros(goal.request)
            call = self.start_call(method, *msgspec.structs.astuple(request))
        except Exception:  # the client waits for the end
            self._finish(service, goal, goal.abort, service.kind.Result())
            raise
        self._calls[bytes(goal.goal_id.uuid)] = call
        call.then(partial(self._end, service, goal))

    def _end(self, service: Service, goal: Any, call: StartedCall[Any]) -> None:  # noqa: ANN401, a goal of rclpy
        del self._calls[bytes(goal.goal_id.uuid)]
        end, result = goal.abort, service.kind.Result()
        try:
            end, result = goal.succeed, service.to_ros(call.result(), result)
        except CallError as error:
            self.log.warning("%s: %s", service.name, error)
        finally:  # the client waits for the end, also of what is no result
            self._finish(service, goal, end, result)

    def _cancel(self, service: Service, goal: Any) -> Any:  # noqa: ANN401, a goal of rclpy
        from rclpy.action import CancelResponse  # noqa: PLC0415, only where a node runs

        call = self._calls.get(bytes(goal.goal_id.uuid))
        if call is None or not call.cancel():
            return CancelResponse.REJECT
        del self._calls[bytes(goal.goal_id.uuid)]
        self._finish(service, goal, goal.canceled, service.kind.Result())
        return CancelResponse.ACCEPT

    def _finish(
        self,
        service: Service,
        goal: Any,  # noqa: ANN401, a goal of rclpy
        enter: Callable[[], None],
        result: Any,  # noqa: ANN401, a message
    ) -> None:
        """Let the goal enter its last state, and its client have the result."""

        def finish(_: object) -> Any:  # noqa: ANN401, a message
            enter()
            return result

        self._servers[service.name].notify_execute(goal, finish)

    def cleanup(self) -> None:
        """Destroy the node, and before it what it does not know."""
        for server in getattr(self, "_servers", {}).values():
            server.destroy()
        super().cleanup()


class AsksActions(AsksRos):
    """Answers the port by the results of goals in ROS 2."""

    def _client(self, kind: Any, name: str) -> Any:  # noqa: ANN401, of rclpy
        from rclpy.action import ActionClient  # noqa: PLC0415, only where a node runs

        return ActionClient(self.node, kind, name)

    def _ask(self, method: str, *arguments: Any) -> Any:  # noqa: ANN401, as the port says
        service, client, name = self._clients[method]
        if not client.wait_for_server(min(time_left(), LONGEST)):
            raise Unavailable(f"nobody offers the action '{name}'")
        request = service.request.to_ros(service.arguments(*arguments))
        goal = self._wait(client.send_goal_async(request), name)
        if not goal.accepted:
            raise RunError(f"'{name}' rejected the goal")
        try:
            ended = self._wait(goal.get_result_async(), name)
        except Timeout:
            goal.cancel_goal_async()
            raise
        if ended.status != _SUCCEEDED:
            how = _ENDS.get(ended.status, f"with the status {ended.status}")
            raise RunError(f"the goal of '{name}' ended {how}")
        return service.from_ros(ended.result)

    def cleanup(self) -> None:
        """Destroy the node, and before it what it does not know."""
        for _, client, _ in getattr(self, "_clients", {}).values():
            client.destroy()
        super().cleanup()


_SUCCEEDED = 4
_ENDS = {5: "cancelled", 6: "aborted"}
"""How goals end, as `action_msgs/msg/GoalStatus` has it."""
