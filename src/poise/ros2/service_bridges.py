"""Services and actions: a provided port is offered to ROS 2, a required one asks."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple, get_type_hints

import msgspec
from msgspec import Struct

from poise.clock import ComponentClock
from poise.errors import (
    CallError,
    RobotError,
    RunError,
    Timeout,
    Unavailable,
    did_you_mean,
    listed,
)
from poise.ros2.bridge_node import BridgeLine, BridgeNode, annotated
from poise.ros2.conversion import Conversion, Conversions
from poise.ros2.interfaces import interface
from poise.runtime.component.component import time_left
from poise.runtime.component.ports import Port, Provided, methods_of
from poise.runtime.component.started_calls import MOST_OPEN, StartedCall

LONGEST = 3600.0
"""A call without a limit waits this long for ROS 2 [s]."""


class Service(NamedTuple):
    """A method of an interface, as a service or an action of ROS 2."""

    name: str
    kind: Any  # the generated class
    arguments: type[Struct]
    request: Conversion
    response: Conversion
    is_plain: bool  # whether the method returns one value, and no message
    answer: type[Struct] | None  # what it returns; None: nothing

    def to_ros(self, result: Any, empty: Any) -> Any:  # noqa: ANN401, messages
        """Return what a method returned; `empty` when that is nothing."""
        if self.answer is None:
            return empty
        return self.response.to_ros(self.answer(result) if self.is_plain else result)

    def from_ros(self, response: Any) -> Any:  # noqa: ANN401, messages
        """Return what the method returns."""
        if self.answer is None:
            return None
        answer = self.response.from_ros(response)
        return msgspec.structs.astuple(answer)[0] if self.is_plain else answer


class Services(BridgeNode):
    """What both ways of services share."""

    @classmethod
    def conversions(cls, clock: ComponentClock) -> list[Service]:
        """Return the service of each entry."""
        known = methods_of(cls.port.type)
        return [_service(cls.port.type, known, entry, clock) for entry in cls.entries]


class ServesRos(Services):
    """Calls the port for clients in ROS 2."""

    def open(self) -> None:
        """Make the services."""
        services = self.conversions(self.clock)
        for entry, service in zip(self.entries, services, strict=True):
            self.node.create_service(
                service.kind, entry.ros2, partial(self._serve, service)
            )

    def _serve(self, service: Service, request: Any, response: Any) -> Any:  # noqa: ANN401, messages
        method = getattr(getattr(self, self.port.name), service.name)
        try:
            arguments = service.request.from_ros(request)
            result = method(*msgspec.structs.astuple(arguments))
            if service.answer is None and hasattr(response, "success"):
                response.success = True
            return service.to_ros(result, response)
        except Exception as error:  # also of what does not fit: the client waits
            if not hasattr(response, "success"):
                raise  # there is no way to say so: the client gets no answer
            self.log.warning("%s: %s", service.name, error)
            response.success = False
            if hasattr(response, "message"):
                response.message = str(error)
            return response


class AsksRos(Services):
    """Answers the port by services of ROS 2."""

    def open(self) -> None:
        """Make the clients, and what waits for them on the thread that calls."""
        from rclpy.executors import SingleThreadedExecutor  # noqa: PLC0415, as above

        self._waiting = SingleThreadedExecutor()
        self.closing.callback(self._waiting.shutdown)
        self._waiting.add_node(self.node)
        services = self.conversions(self.clock)
        self._clients = {
            service.name: (service, self._client(service.kind, entry.ros2), entry.ros2)
            for entry, service in zip(self.entries, services, strict=True)
        }

    def _client(self, kind: Any, name: str) -> Any:  # noqa: ANN401, of rclpy
        return self.node.create_client(kind, name)

    def listen(self) -> None:
        """Wait only for what was asked."""

    def _ask(self, method: str, *arguments: Any) -> Any:  # noqa: ANN401, as the port says
        service, client, name = self._clients[method]
        limit = min(time_left(), LONGEST)
        if not client.service_is_ready() and not client.wait_for_service(limit):
            raise Unavailable(f"nobody serves '{name}'")
        request = service.request.to_ros(service.arguments(*arguments))
        return service.from_ros(self._wait(client.call_async(request), name))

    def _wait(self, future: Any, name: str, *, is_left: bool = False) -> Any:  # noqa: ANN401, of rclpy
        """Return what a future brings while the caller waits.

        `is_left`: after that it still takes what comes.
        """
        limit = min(time_left(), LONGEST)
        self._waiting.spin_until_future_complete(future, limit)
        if not future.done():
            if not is_left:
                future.cancel()
            raise Timeout(f"'{name}' gave no answer within {limit:.3g} s")
        return future.result()


def _service(
    port: type, known: Sequence[str], entry: BridgeLine, clock: ComponentClock
) -> Service:
    """Return a method as a service, or RobotError when it does not fit."""
    if entry.method not in known:
        raise RobotError(
            f"{port.__qualname__} has no method '{entry.method}'"
            f"{did_you_mean(entry.method, known)}; methods: {listed(known)}"
        )
    kind, method = interface(entry.type), getattr(port, entry.method)
    is_action = hasattr(kind, "Goal")
    request = kind.Goal if is_action else kind.Request
    response = kind.Result if is_action else kind.Response
    hints = get_type_hints(method)
    result = hints.pop("return", type(None))
    names = list(inspect.signature(method).parameters)[1:]
    where = f"{port.__qualname__}.{entry.method}"
    arguments = msgspec.defstruct(where, [(n, hints.get(n, Any)) for n in names])
    is_message = isinstance(result, type) and issubclass(result, Struct)
    answer: type[Struct] | None = result if is_message else None
    if not is_message and result is not type(None):
        fields = response.get_fields_and_field_types()
        field = next(iter(fields)) if len(fields) == 1 else "success"
        answer = msgspec.defstruct(f"{where}()", [(field, result)])
    of = Conversions(clock).of
    return Service(
        name=entry.method,
        kind=kind,
        arguments=arguments,
        request=of(arguments, request),
        response=_NOTHING if answer is None else of(answer, response),
        is_plain=not is_message and answer is not None,
        answer=answer,
    )


_NOTHING = Conversion(lambda _: None, lambda _: None)


def answering(port: Port, entries: Sequence[BridgeLine]) -> dict[str, Any]:
    """Return what declares the port of `AsksRos`: it has all methods."""
    lacking = sorted(set(methods_of(port.type)) - {e.method for e in entries})
    if lacking:
        raise RobotError(
            f"'{port.name}' requires {listed(lacking)}, too, which no bridge answers: "
            "add a line to `bridges` for each method"
        )

    def asking(method: str) -> Callable[..., Any]:
        def ask(self: Any, *arguments: Any) -> Any:  # noqa: ANN401, as the port says
            return self._ask(method, *arguments)

        return ask

    methods = {entry.method: asking(entry.method) for entry in entries}
    return {**annotated(Provided)(port, entries), **methods}


class Goals(Struct, frozen=True):
    """The goals taken last, and the results that no client has asked for yet."""

    taken: Sequence[str]
    results: Mapping[str, bytes]  # as ROS 2 sends them


class ServesActions(Services):
    """Calls the port for the goals of clients in ROS 2, without waiting for it.

    All of a goal is done in turns of the component, not in tasks of rclpy's executor,
    so none of it is left when the component is paused. Where it moves, its successor
    gets what clients ask meanwhile, too, and does what this has not done.
    """

    def open(self) -> None:
        """Know no goals; make the servers where clients are to find both."""
        self._servers: dict[str, Any] = {}
        self._calls: dict[str, StartedCall[Any]] = {}
        self._asking: dict[str, list[Any]] = {}
        self._taken: dict[str, bool] = {}  # whether the result was asked for
        self._before = Goals((), {})
        self._takes = False
        if self._context.follows:
            self._offer()

    def _offer(self) -> None:
        from rclpy.action import ActionServer, GoalResponse  # noqa: PLC0415, only where a node runs

        def accept(_: object) -> GoalResponse:
            has_room = len(self._calls) < MOST_OPEN
            return GoalResponse.ACCEPT if has_room else GoalResponse.REJECT

        services = self.conversions(self.clock)
        for entry, service in zip(self.entries, services, strict=True):
            server: Any = ActionServer(
                self.node,
                service.kind,
                entry.ros2,
                lambda _: None,
                goal_callback=accept,
                handle_accepted_callback=partial(self._begin, service),
                cancel_callback=partial(self._cancel, service),
                goal_service_qos_profile=_waiting_goals(),
                result_service_qos_profile=_waiting_goals(),
            )
            self.closing.callback(server.destroy)
            take = server._execute_goal_request  # noqa: SLF001
            say_unknown = server._execute_get_result_request  # noqa: SLF001
            server._execute_goal_request = partial(self._take, take)  # noqa: SLF001
            answer = partial(self._answer, server, say_unknown)
            server._execute_get_result_request = answer  # noqa: SLF001
            self._servers[service.name] = server

    def snapshot(self) -> Goals:
        """Return what its successor needs to know of goals."""
        from rclpy.serialization import serialize_message  # noqa: PLC0415, as above

        before = {
            key: data
            for key, data in self._before.results.items()
            if not self._taken.get(key, True)
        }
        results = {
            key.hex(): serialize_message(future.result())
            for server in self._servers.values()
            for key, future in server._result_futures.items()  # noqa: SLF001
            if future.done() and not self._taken.get(key.hex(), True)
        }
        return Goals([*self._taken], before | results)

    def restore(self, state: Goals) -> None:
        """Take no goal that the bridge before has taken, and give its results."""
        self._before = state
        self._taken = {key: key not in state.results for key in state.taken}

    def listen(self) -> None:
        """Begin with the goals that have come; what was to be cancelled has ended."""
        if not self._servers:
            self._offer()
        for server in self._servers.values():
            kind = server.action_type.Impl.CancelGoalService.Request
            while server._handle.take_cancel_request(kind)[0] is not None:  # noqa: SLF001
                pass
        self._takes = True
        super().listen()

    def deactivate(self) -> None:
        """Take no goal any more, but give all results that were asked for."""
        super().deactivate()
        self._takes = False
        self.source.run_due()
        for server in self._servers.values():
            kind = server.action_type.Impl.GetResultService.Request
            while (request := server._handle.take_result_request(kind))[0] is not None:  # noqa: SLF001
                self._give(server, *request)

    async def _take(self, take: Callable[[Any], Any], request: Any) -> None:  # noqa: ANN401, of rclpy
        key = _key(request[1])
        if self._takes and key not in self._before.taken:
            self._taken[key] = False
            if len(self._taken) > _MOST_TAKEN:
                del self._taken[next(iter(self._taken))]
            await take(request)

    async def _answer(
        self,
        server: Any,  # noqa: ANN401, of rclpy
        say_unknown: Callable[[Any], Any],
        request: Any,  # noqa: ANN401, of rclpy
    ) -> None:
        if not self._give(server, *request) and self._takes:
            await say_unknown(request)

    def _give(self, server: Any, header: Any, asked: Any) -> bool:  # noqa: ANN401, of rclpy
        """Give the result of a goal, at the latest when it ends, if it is known."""
        from rclpy.serialization import deserialize_message  # noqa: PLC0415, as above

        key = _key(asked)
        ended = server._result_futures.get(bytes.fromhex(key))  # noqa: SLF001
        if key in self._taken:
            self._taken[key] = True
        if ended is not None:
            if ended.done():
                server._send_result_response(header, ended)  # noqa: SLF001
            else:
                self._asking.setdefault(key, []).append(header)
        elif data := self._before.results.get(key):
            kind = server.action_type.Impl.GetResultService.Response
            response = deserialize_message(data, kind)
            server._handle.send_result_response(header, response)  # noqa: SLF001
        return ended is not None or key in self._before.taken

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
        self._calls[_key(goal)] = call
        call.then(partial(self._end, service, goal))

    def _end(self, service: Service, goal: Any, call: StartedCall[Any]) -> None:  # noqa: ANN401, a goal of rclpy
        del self._calls[_key(goal)]
        end, result = goal.abort, service.kind.Result()
        try:
            end, result = goal.succeed, service.to_ros(call.result(), result)
        except CallError as error:
            self.log.warning("%s: %s", service.name, error)
        finally:  # the client waits for the end, also of what is no result
            self._finish(service, goal, end, result)

    def _cancel(self, service: Service, goal: Any) -> Any:  # noqa: ANN401, a goal of rclpy
        from rclpy.action import CancelResponse  # noqa: PLC0415, only where a node runs

        call = self._calls.get(_key(goal))
        if call is None or not call.cancel():
            return CancelResponse.REJECT
        del self._calls[_key(goal)]
        empty = service.kind.Result()
        self.start_call(lambda: None).then(  # rclpy lets it be cancelled first
            lambda _: self._finish(service, goal, goal.canceled, empty)
        )
        return CancelResponse.ACCEPT

    def _finish(
        self,
        service: Service,
        goal: Any,  # noqa: ANN401, a goal of rclpy
        enter: Callable[[], None],
        result: Any,  # noqa: ANN401, a message
    ) -> None:
        """Let the goal enter its last state, and its clients have the result."""
        enter()
        server, key = self._servers[service.name], _key(goal)
        response = service.kind.Impl.GetResultService.Response()
        response.status, response.result = goal.status, result
        ended = server._result_futures[bytes.fromhex(key)]  # noqa: SLF001
        ended.set_result(response)
        for header in self._asking.pop(key, ()):
            server._send_result_response(header, ended)  # noqa: SLF001


_MOST_TAKEN = 1000
"""The most goals that are known: those taken last."""


def _waiting_goals() -> Any:  # noqa: ANN401, a profile of rclpy
    """Return the profile of services, with room for all that comes amid a move."""
    from rclpy import qos  # noqa: PLC0415, only where a node runs

    profile = copy.copy(qos.qos_profile_services_default)
    profile.depth = _MOST_TAKEN
    return profile


def _key(goal: Any) -> str:  # noqa: ANN401, what has the id of a goal
    return bytes(goal.goal_id.uuid).hex()


class AsksActions(AsksRos):
    """Answers the port by the results of goals in ROS 2."""

    def _client(self, kind: Any, name: str) -> Any:  # noqa: ANN401, of rclpy
        from rclpy.action import ActionClient  # noqa: PLC0415, only where a node runs

        client = ActionClient(self.node, kind, name)
        self.closing.callback(client.destroy)
        return client

    def _ask(self, method: str, *arguments: Any) -> Any:  # noqa: ANN401, as the port says
        service, client, name = self._clients[method]
        if not client.wait_for_server(min(time_left(), LONGEST)):
            raise Unavailable(f"nobody offers the action '{name}'")
        request = service.request.to_ros(service.arguments(*arguments))
        sent = client.send_goal_async(request)
        try:
            goal = self._wait(sent, name, is_left=True)
        except Timeout:
            self._waiting.spin_until_future_complete(sent, _ACCEPTED_WITHIN)
            if sent.done():
                _cancel_accepted(sent)
            else:  # whenever something is asked again
                sent.add_done_callback(_cancel_accepted)
            raise
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


_ACCEPTED_WITHIN = 1.0
"""So long is waited for a goal that may be accepted although its caller has given up:
it is to be cancelled [s]."""


def _cancel_accepted(sent: Any) -> None:  # noqa: ANN401, a future of rclpy
    if (goal := sent.result()) is not None and goal.accepted:
        goal.cancel_goal_async()


_SUCCEEDED = 4
_ENDS = {5: "cancelled", 6: "aborted"}
"""How goals end, as `action_msgs/msg/GoalStatus` has it."""
