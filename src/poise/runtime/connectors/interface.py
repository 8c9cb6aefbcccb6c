"""The tags and codecs of an interface or a topic."""

from __future__ import annotations

import inspect
import zlib
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from types import FunctionType
from typing import Any, NoReturn, get_type_hints

from msgspec import Struct

from poise.errors import Unavailable, UsageError, did_you_mean, listed
from poise.runtime.component.implementation import fingerprint
from poise.runtime.component.ports import Port, is_oneway, methods_of
from poise.wire.codec import Codec, codec


class Method(Struct, frozen=True):
    """A method of an interface."""

    name: str
    tag: int
    oneway: bool
    parameters: tuple[inspect.Parameter, ...]
    bind: Callable[..., tuple[Any, ...]]
    arguments: Codec[tuple[Any, ...]]
    result: Codec[Any]


@cache
def methods(interface: type) -> Mapping[int, Method]:
    """Return the methods of an interface by tag."""
    by_tag: dict[int, Method] = {}
    for name in methods_of(interface):
        method = _method(interface, name)
        if method.tag in by_tag:
            raise UsageError(
                f"methods {name} and {by_tag[method.tag].name} of "
                f"{interface.__qualname__} have the same tag: rename one"
            )
        by_tag[method.tag] = method
    return by_tag


def carries_messages(port: Port) -> bool:
    """Return whether messages or one-way calls go over a port's connectors."""
    if port.kind in {"publishes", "subscribes"}:
        return True
    return any(method.oneway for method in methods(port.type).values())


def tag_of(description: str) -> int:
    """Return the 16-bit checksum that identifies a method or message type."""
    return zlib.crc32(description.encode()) & 0xFFFF


@cache
def message_tag(type_: type) -> int:
    """Return the tag of a message type: equal where the check lets types fit."""
    return tag_of(repr(fingerprint(type_)))


def _method(interface: type, name: str) -> Method:
    function = getattr(interface, name)
    signature = inspect.signature(function)
    own = list(signature.parameters.values())[1:]
    hints = get_type_hints(function, include_extras=True)
    for parameter in own:
        if parameter.name not in hints or parameter.kind in {
            parameter.VAR_POSITIONAL,
            parameter.KEYWORD_ONLY,
            parameter.VAR_KEYWORD,
        }:
            raise UsageError(
                f"{interface.__qualname__}.{name}: parameter '{parameter.name}' needs "
                "a type and a place of its own, not after `*`: it could not cross a "
                "connector"
            )
    types = tuple(hints[parameter.name] for parameter in own)
    result = hints.get("return", type(None))
    # tuple[*()] would mean "any tuple"
    arguments = tuple[types] if types else tuple[()]  # type: ignore[valid-type]
    call = f"{interface.__qualname__}.{name}"
    return Method(
        name=name,
        tag=tag_of(f"{name}{fingerprint(arguments)}{fingerprint(result)}"),
        oneway=is_oneway(interface, name),
        parameters=_unannotated(own),
        bind=_binder(signature.replace(parameters=own)),
        arguments=codec(arguments, f"arguments of {call}"),
        result=codec(result, f"a result of {call}"),
    )


def _unannotated(
    parameters: Iterable[inspect.Parameter],
) -> tuple[inspect.Parameter, ...]:
    return tuple(each.replace(annotation=each.empty) for each in parameters)


def as_declared(run: Callable[..., Any], method: Method) -> Callable[..., Any]:
    """Return a method of a target that takes names and defaults of the interface."""
    function = getattr(run, "__func__", run)
    if not isinstance(function, FunctionType) or hasattr(function, "__signature__"):
        return run  # written in C++
    own = inspect.signature(run, follow_wrapped=False).parameters.values()
    if _unannotated(own) == method.parameters:
        return run
    return lambda *args, **kwargs: run(*method.bind(*args, **kwargs))


def _binder(signature: inspect.Signature) -> Callable[..., tuple[Any, ...]]:
    num = len(signature.parameters)

    def bind(*args: Any, **kwargs: Any) -> tuple[Any, ...]:  # noqa: ANN401, a call's
        if len(args) == num and not kwargs:
            return args
        bound = signature.bind(*args, **kwargs)
        bound.apply_defaults()
        return tuple(bound.arguments.values())

    return bind


class Proxy:
    """What a required port holds: the interface's methods as attributes."""

    def __init__(self, what: str) -> None:
        self._what = what

    def __getattr__(self, name: str) -> NoReturn:
        """Name the methods that exist; Python asks only for one that does not."""
        known = [var for var in vars(self) if not var.startswith("_")]
        raise AttributeError(
            f"{self._what} has no method '{name}'{did_you_mean(name, known)}; "
            f"methods: {listed(known)}"
        )


def refusing(what: str) -> Callable[..., NoReturn]:
    """Return a function that raises `Unavailable`, however it is called."""

    def call(*_: object, **__: object) -> NoReturn:
        raise Unavailable(f"'{what}' is not connected")

    return call


def oneway_function(
    method: Method, send: Callable[[object, Method], None]
) -> Callable[..., None]:
    """Return a function that sends the arguments of a one-way call."""

    def call(*args: Any, **kwargs: Any) -> None:  # noqa: ANN401, the call's own
        send(method.bind(*args, **kwargs), method)

    return call
