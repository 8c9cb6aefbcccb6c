"""Joins a port of a component with ROS 2: the component knows nothing of it.

A bridge is a component itself, connected to the port; so it is placed, measured and
restarted as others are. Which way messages go, the port says.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, ClassVar, NamedTuple, get_type_hints

import msgspec
from msgspec import Struct

from poise.clock import ComponentClock, SystemClock
from poise.errors import (
    CallError,
    RobotError,
    Timeout,
    Unavailable,
    did_you_mean,
    listed,
)
from poise.ros2 import ros_context
from poise.ros2.conversion import Conversion, Conversions, Convert
from poise.ros2.executor_source import ExecutorSource
from poise.ros2.interfaces import interface, named
from poise.runtime.component.component import Component, time_left
from poise.runtime.component.implementation import find
from poise.runtime.component.ports import (
    Port,
    Provided,
    Published,
    Required,
    methods_of,
    ports_of,
    published,
    subscribed,
)

_LONGEST = 3600.0
"""A call without a limit waits this long for ROS 2 [s]."""


class BridgeLine(Struct, frozen=True, kw_only=True):
    """One line of `bridges` in the robot file."""

    ros2: str
    method: str = ""
    type: str = ""
    reliability: str | None = None
    durability: str | None = None
    depth: int = 10
    port: str = ""

    @property
    def keeps_last(self) -> bool:
        """Whether late subscribers get the last message."""
        return self.durability == "transient local"

    def qos(self, **policies: Any) -> Any:  # noqa: ANN401, a profile of rclpy
        """Return the quality of service that it asks for, with other `policies`."""
        from rclpy import qos  # noqa: PLC0415, only where a node runs

        given = {
            "reliability": (self.reliability or "reliable").replace(" ", "_").upper(),
            "durability": (self.durability or "volatile").replace(" ", "_").upper(),
            **policies,
        }
        return qos.QoSProfile(
            depth=self.depth,
            reliability=qos.ReliabilityPolicy[given["reliability"]],
            durability=qos.DurabilityPolicy[given["durability"]],
        )


class Bridge(Component):
    """The other end of the port that its parameters name."""

    port: ClassVar[Port]
    entries: ClassVar[Sequence[BridgeLine]]

    @classmethod
    def __poise_specialised__(
        cls, parameters: Mapping[str, Any], folder: str
    ) -> type[Component]:
        """Return a class whose port fits the port that it bridges."""
        ros_context.rclpy()
        component, name = find(parameters["of"], folder), parameters["port"]
        ports = ports_of(component)
        if name not in ports:
            raise RobotError(
                f"'{parameters['of']}' has no port '{name}'"
                f"{did_you_mean(name, ports)}; ports: {listed(ports)}"
            )
        port, entries = (
            ports[name],
            msgspec.convert(parameters["bridges"], list[BridgeLine]),
        )
        base, kind, declaring = _SIDES[port.kind]
        entries = [_full(port, kind, entry) for entry in entries]
        own = {"port": port, **declaring(port, entries)}
        own["entries"] = [_keeping_last(port, entry) for entry in entries]
        made: Any = type(cls.__name__, (base,), own)
        made.conversions(SystemClock())  # `poise check` says what misfits
        return made  # type: ignore[no-any-return]

    @classmethod
    def conversions(cls, clock: ComponentClock) -> Any:  # noqa: ANN401, for each entry
        """Return what converts the values of each entry; RobotError: they misfit."""
        raise NotImplementedError

    def configure(self) -> None:
        """Make a node of its own."""
        ros_context.join(self.parameters["environment"])
        self._is_joined = True
        self.node = ros_context.node_of(re.sub(r"\W", "_", f"poise_{self.name}"))
        self.source = ExecutorSource(self.node, self._context.give_up)
        self.open()

    def open(self) -> None:
        """Make the node's ends."""
        raise NotImplementedError

    def activate(self) -> None:
        """Begin to hear ROS 2."""
        if self._context.takes_over():
            ros_context.drop_what_came(self.node)
        self.listen()

    def listen(self) -> None:
        """Let callbacks run on the component's thread."""
        self._context.listen(self.source)

    def deactivate(self) -> None:
        """Hear nothing any more."""
        self._context.listen(None)

    def cleanup(self) -> None:
        """Destroy the node."""
        if getattr(self, "_is_joined", False):
            self._is_joined = False
            if hasattr(self, "source"):
                self.source.close()
                self.node.destroy_node()
            ros_context.leave()


class ToTopics(Bridge):
    """Subscribes to the port, and publishes in ROS 2.

    It has no state, so it gets the last message of a port again where it moves to, and
    its new publishers have one for late subscribers.
    """

    @classmethod
    def conversions(cls, clock: ComponentClock) -> list[Conversion]:
        """Return how the messages of each entry are converted."""
        of = Conversions(clock).of
        return [of(cls.port.type, interface(entry.type)) for entry in cls.entries]

    def open(self) -> None:
        """Make the publishers."""
        pairs = zip(self.entries, self.conversions(self.clock), strict=True)
        self._out = [(self._publish_of(entry), pair.to_ros) for entry, pair in pairs]

    def listen(self) -> None:
        """Do not wait for ROS 2, from where nothing comes."""

    def _publish_of(self, entry: BridgeLine) -> Convert:
        kind = interface(entry.type)
        publisher = self.node.create_publisher(kind, entry.ros2, entry.qos())
        return publisher.publish  # type: ignore[no-any-return]

    def _take(self, message: Any) -> None:  # noqa: ANN401, as the port says
        for publish, to_ros in self._out:
            publish(to_ros(message))


class Came(Struct, frozen=True):
    """When the last message that was taken had been published [ns since 1970]."""

    stamp: int


class FromTopics(ToTopics):
    """Subscribes in ROS 2, and publishes to the port."""

    def configure(self) -> None:
        """Make a node of its own."""
        self._before = self._came = 0
        super().configure()

    def snapshot(self) -> Came:
        """Return until when it took messages: ROS 2 sends some again."""
        return Came(self._came)

    def restore(self, state: Came) -> None:
        """Take nothing that the bridge before has taken."""
        self._before = self._came = state.stamp

    def open(self) -> None:
        """Make the subscriptions."""
        for entry, pair in zip(self.entries, self.conversions(self.clock), strict=True):
            self._subscribe(entry, pair.from_ros, {})

    def listen(self) -> None:
        """Let callbacks run on the component's thread."""
        Bridge.listen(self)

    def _subscribe(
        self, entry: BridgeLine, from_ros: Convert, less: dict[str, str]
    ) -> None:
        """Subscribe; with `less` when a publisher offers no more, which is said."""
        from rclpy.event_handler import SubscriptionEventCallbacks  # noqa: PLC0415, only where a node runs

        def take(message: Any) -> None:  # noqa: ANN401, a message
            # the port is wired later, and again
            getattr(self, self.port.name).publish(from_ros(message))

        def take_new(message: Any, info: Mapping[str, Any]) -> None:  # noqa: ANN401, a message
            stamp = info["source_timestamp"]
            if stamp > self._before:
                self._came = max(self._came, stamp)
                take(message)

        def offered_less(event: Any) -> None:  # noqa: ANN401, an event
            policy = event.last_policy_kind.name.lower().rpartition("_")[2]
            if policy in less or policy not in _LEAST or getattr(entry, policy):
                raise RobotError(
                    f"'{entry.ros2}' has a publisher that offers less {policy} than "
                    "the bridge asks for: nothing comes from it"
                )
            self.log.warning(
                "'%s' has a publisher without %s: so take what comes",
                entry.ros2,
                policy,
            )
            self.node.destroy_subscription(subscription)
            self._subscribe(entry, from_ros, {**less, **_LEAST[policy]})

        subscription = self.node.create_subscription(
            interface(entry.type),
            entry.ros2,
            take_new if entry.keeps_last else take,
            entry.qos(**less),
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=offered_less),
        )


_LEAST = {"reliability": {"reliability": "BEST_EFFORT"}}


class Service(NamedTuple):
    """A method of an interface, as a service of ROS 2."""

    name: str
    kind: Any  # the generated class
    arguments: type[Struct]
    request: Conversion
    response: Conversion
    is_plain: bool  # whether the method returns one value, and no message
    answer: type[Struct] | None  # what it returns; None: nothing


class Services(Bridge):
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
        arguments = service.request.from_ros(request)
        method = getattr(getattr(self, self.port.name), service.name)
        try:
            result = method(*msgspec.structs.astuple(arguments))
        except CallError as error:
            if not hasattr(response, "success"):
                raise  # there is no way to say so: the client gets no answer
            self.log.warning("%s: %s", service.name, error)
            response.success = False
            if hasattr(response, "message"):
                response.message = str(error)
            return response
        if service.answer is None:
            if hasattr(response, "success"):
                response.success = True
            return response
        return service.response.to_ros(
            service.answer(result) if service.is_plain else result
        )


class AsksRos(Services):
    """Answers the port by services of ROS 2."""

    def open(self) -> None:
        """Make the clients, and what waits for them on the thread that calls."""
        from rclpy.executors import SingleThreadedExecutor  # noqa: PLC0415, as above

        self._waiting = SingleThreadedExecutor()
        self._waiting.add_node(self.node)
        self._clients = {
            service.name: (
                service,
                self.node.create_client(service.kind, entry.ros2),
            )
            for entry, service in zip(
                self.entries, self.conversions(self.clock), strict=True
            )
        }

    def listen(self) -> None:
        """Wait only for what was asked."""

    def _ask(self, method: str, *arguments: Any) -> Any:  # noqa: ANN401, as the port says
        service, client = self._clients[method]
        limit = min(time_left(), _LONGEST)
        if not client.service_is_ready() and not client.wait_for_service(limit):
            raise Unavailable(f"nobody serves '{client.srv_name}'")
        request = service.request.to_ros(service.arguments(*arguments))
        future = client.call_async(request)
        self._waiting.spin_until_future_complete(future, min(time_left(), _LONGEST))
        if not future.done():
            client.remove_pending_request(future)
            raise Timeout(f"'{client.srv_name}' gave no answer within {limit:.3g} s")
        if service.answer is None:
            return None
        answer = service.response.from_ros(future.result())
        return msgspec.structs.astuple(answer)[0] if service.is_plain else answer

    def cleanup(self) -> None:
        """Destroy the node."""
        if hasattr(self, "_waiting"):
            self._waiting.shutdown()
        super().cleanup()


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
    hints = get_type_hints(method)
    result = hints.pop("return", type(None))
    names = list(inspect.signature(method).parameters)[1:]
    where = f"{port.__qualname__}.{entry.method}"
    arguments = msgspec.defstruct(where, [(n, hints.get(n, Any)) for n in names])
    is_message = isinstance(result, type) and issubclass(result, Struct)
    answer: type[Struct] | None = result if is_message else None
    if not is_message and result is not type(None):
        fields = kind.Response.get_fields_and_field_types()
        field = next(iter(fields)) if len(fields) == 1 else "success"
        answer = msgspec.defstruct(f"{where}()", [(field, result)])
    of = Conversions(clock).of
    return Service(
        name=entry.method,
        kind=kind,
        arguments=arguments,
        request=of(arguments, kind.Request),
        response=_NOTHING if answer is None else of(answer, kind.Response),
        is_plain=not is_message and answer is not None,
        answer=answer,
    )


_NOTHING = Conversion(lambda _: None, lambda _: None)


def _taking(port: Port, entries: Sequence[BridgeLine]) -> dict[str, Any]:
    def take(self: Any, message: Any) -> None:  # noqa: ANN401, as the port says
        self._take(message)

    take.__annotations__["message"] = port.type
    keep = max(entry.depth for entry in entries)
    return {f"take_{port.name}": subscribed(port.name, keep=keep)(take)}


def _answering(port: Port, entries: Sequence[BridgeLine]) -> dict[str, Any]:
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
    return {**_annotated(Provided)(port, entries), **methods}


def _publishing(port: Port, entries: Sequence[BridgeLine]) -> dict[str, Any]:
    latest = any(entry.keeps_last for entry in entries)
    return {
        port.name: published(latest=latest),
        **_annotated(Published)(port, entries),
    }


def _keeping_last(port: Port, entry: BridgeLine) -> BridgeLine:
    """Return an entry as the port asks for it, where it says nothing of durability."""
    if not port.latest or entry.durability:
        return entry
    return msgspec.structs.replace(entry, durability="transient local", depth=1)


def _annotated(form: Any) -> Callable[..., dict[str, Any]]:  # noqa: ANN401, of a port
    return lambda port, _: {"__annotations__": {port.name: form[port.type]}}


_SIDES: Mapping[str, tuple[type[Bridge], str, Callable[..., dict[str, Any]]]] = {
    "publishes": (ToTopics, "msg", _taking),
    "subscribes": (FromTopics, "msg", _publishing),
    "provides": (ServesRos, "srv", _annotated(Required)),
    "requires": (AsksRos, "srv", _answering),
}
"""The kind of a port -> what bridges it, and how that declares its own port."""


def _full(port: Port, kind: str, entry: BridgeLine) -> BridgeLine:
    """Return an entry with its type, and its method."""
    full = entry.type or named(port.type.__qualname__, kind)
    if full.split("/")[1] != kind:
        raise RobotError(
            f"'{port.name}' {port.kind}, so it takes no {full}, but a {kind}"
        )
    method = entry.method
    if kind == "srv" and not method:
        known = methods_of(port.type)
        if len(known) != 1:
            raise RobotError(
                f"'{port.name}' has several methods, so write `method: ` one of "
                f"{listed(known)}"
            )
        method = known[0]
    return msgspec.structs.replace(entry, type=full, method=method)
