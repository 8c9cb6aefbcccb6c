"""A node of rclpy that is a component, without a line of it changed.

What Poise calls configure, activate, deactivate and cleanup, a lifecycle node does,
too. Another node is made, spins, and is destroyed.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import partial
from typing import Any, get_type_hints

import msgspec

from poise.errors import RobotError, UsageError, did_you_mean, listed
from poise.model.ros2_node import START, as_arguments, flat
from poise.ros2 import ros_context
from poise.ros2.arrivals import Arrivals
from poise.ros2.executor_source import ExecutorSource
from poise.runtime.component.component import Component
from poise.runtime.component.implementation import find_function

_TYPE = re.compile(r"(?:(?<=expected )|(?<= got ))'(\d+)'")


class RosNode(Component):
    """Runs the node that its parameters name, and no other parameter is its own."""

    _start_parameters = frozenset({START})
    _hands_over = False
    _raised: Exception | None = None
    make: Callable[[], Any]

    @classmethod
    def __poise_specialised__(
        cls, parameters: Mapping[str, Any], folder: str
    ) -> type[Component]:
        """Return a class that hands the node's state over, if it has any."""
        ros_context.rclpy()
        make = find_function(parameters[START]["node"], folder)
        code = make if inspect.isclass(make) else get_type_hints(make).get("return")
        own: dict[str, Any] = {"make": staticmethod(make)}
        if hasattr(code, "snapshot") and hasattr(code, "restore"):
            own |= _handing_over(code)
        return type(cls.__name__, (cls,), own)

    def __init__(self) -> None:
        self._closing = ExitStack()

    def configure(self) -> None:
        """Make the node; a lifecycle node is configured."""
        start = self.parameters[START]
        ros_context.join(start["environment"])
        self._closing.callback(ros_context.leave)
        values = {k: v for k, v in self.parameters.items() if k != START}
        with ros_context.arguments_given([*start["arguments"], *as_arguments(values)]):
            self.node = _made(type(self).make, start["node"])
        self._closing.callback(self.node.destroy_node)
        self._closing.callback(self._transit, "cleanup")
        hooks = getattr(self.node, "_callbacks", {})  # of a lifecycle node
        hooks.update(
            {state: partial(self._call, hook) for state, hook in hooks.items()}
        )
        self._transit("configure")
        for name, _ in flat(values):
            self._check_declared(name)
        self._arrivals = Arrivals()
        if self._hands_over:
            self._arrivals.watch(self.node)
        self._source = ExecutorSource(self.node, self._context.give_up)
        self._closing.callback(self._source.close)

    def activate(self) -> None:
        """Begin to run its callbacks; what its predecessor had is not taken again."""
        if self._context.takes_over():
            ros_context.drop_requests(self.node)
            if not self._hands_over:
                ros_context.drop_messages(self.node)
        self._transit("activate")
        self._context.listen(self._source)

    def deactivate(self) -> None:
        """Run no callback any more."""
        self._context.listen(None)
        self._transit("deactivate")

    def cleanup(self) -> None:
        """Destroy the node."""
        self._context.listen(None)
        self._closing.close()

    def reconfigure(self, parameters: Mapping[str, Any]) -> None:
        """Let the node take other parameters, or refuse them."""
        from rclpy.parameter import Parameter  # noqa: PLC0415, only where a node runs

        before = dict(flat(self.parameters))
        changes = {k: v for k, v in flat(parameters) if before.get(k) != v}
        new = [Parameter(name, value=value) for name, value in changes.items()]
        result = self.node.set_parameters_atomically(new)
        if not result.successful:
            # rclpy has types as numbers there
            reason = _TYPE.sub(lambda t: Parameter.Type(int(t[1])).name, result.reason)
            raise UsageError(f"the node refused: {reason or 'without a reason'}")

    def _settable(self) -> Mapping[str, Any]:
        """Return the parameters that the node declares, too."""
        declared = {k: p.value for k, p in self.node._parameters.items()}  # noqa: SLF001, as below
        return {**declared, **super()._settable()}

    def _check_declared(self, name: str) -> None:
        node = self.node
        known = [*node._parameters]  # noqa: SLF001, rclpy lists those with prefixes only
        if name not in known and not node._allow_undeclared_parameters:  # noqa: SLF001
            self.log.warning(
                "the node declares no parameter '%s'%s; it declares %s",
                name,
                did_you_mean(name, known),
                listed(known),
            )

    def _transit(self, name: str) -> None:
        trigger = getattr(self.node, f"trigger_{name}", None)
        if trigger is None:
            return
        state = self.node._state_machine.current_state[1]  # noqa: SLF001, rclpy says it by a service only
        if state != _LEFT.get(name, state):
            return  # an error has led it elsewhere
        self._raised = None
        result = trigger()
        if self._raised is not None:
            raise self._raised
        if result.name != "SUCCESS":
            raise RobotError(f"the lifecycle node's on_{name} returned {result.name}")

    def _call(self, hook: Callable[[object], Any], state: object) -> Any:  # noqa: ANN401, as it is
        """Call what rclpy calls in a transition, and would not say what it raised."""
        try:
            return hook(state)
        except Exception as error:
            self._raised = self._raised or error  # not what `on_error` raises then
            raise


_LEFT = {"deactivate": "active", "cleanup": "inactive"}
"""The states that transitions of a lifecycle node lead from."""


def _made(make: Callable[[], Any], reference: str) -> Any:  # noqa: ANN401, a node
    from rclpy.node import Node  # noqa: PLC0415, only where a node runs

    try:
        inspect.signature(make).bind()
    except TypeError as error:
        raise RobotError(
            f"'{reference}' is not made without arguments ({error}): name a function "
            "that makes the node and takes none"
        ) from None
    node = make()
    if not isinstance(node, Node):
        raise RobotError(
            f"'{reference}' made a {type(node).__qualname__}, not a node of rclpy"
        )
    return node


def _handing_over(code: Any) -> dict[str, Any]:  # noqa: ANN401, a class
    """Return methods that hand a node's state over, and say its type."""
    hints = get_type_hints(code.restore)
    hints.pop("return", None)
    kind = next(iter(hints.values()), Any)
    fields = [("stamps", dict[str, int]), ("state", kind | None)]
    state_of = msgspec.defstruct("NodeState", fields)

    def snapshot(self: RosNode) -> Any:  # noqa: ANN401, a `NodeState`
        return state_of(dict(self._arrivals.stamps), self.node.snapshot())

    def restore(self: RosNode, state: Any) -> None:  # noqa: ANN401, a `NodeState`
        self._arrivals.go_on_from(state.stamps)
        if state.state is not None:
            self.node.restore(state.state)

    restore.__annotations__["state"] = state_of
    return {"_hands_over": True, "snapshot": snapshot, "restore": restore}
