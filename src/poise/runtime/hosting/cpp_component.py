"""Classes for components in C++ and their messages, made by `poise/component.hpp`."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from types import MethodType, new_class
from typing import Annotated, Any

import msgspec

from poise.errors import UsageError
from poise.runtime.component.component import Component
from poise.runtime.component.ports import (
    Message,
    Provided,
    Published,
    Required,
    every,
    oneway,
    published,
    subscribed,
)
from poise.runtime.connectors.interface import Proxy

Types = Mapping[str, Any]
"""Annotations by name, in their order."""
Make = Callable[[Component], tuple[Mapping[str, Any], Callable[..., None], object]]

_LARGEST = 2**63 - 1
"""The largest limit of an integer that msgspec takes."""


class CppError(Exception):
    """What code in C++ threw; a subclass has the name of its type."""


@cache
def _error_class(type_name: str) -> type[CppError]:
    return type(type_name, (CppError,), {"__module__": "builtins"})


def error(type_name: str, message: str) -> CppError:
    """Return what stands for an exception of C++."""
    return _error_class(type_name)(message)


def integer_type(least: int, most: int) -> object:
    """Return the annotation of integers of one type."""
    limits = msgspec.Meta(ge=least, le=most if most <= _LARGEST else None)
    return Annotated[int, limits]


def array_type(dtype: str) -> object:
    """Return the annotation of arrays of one type."""
    import numpy as np  # noqa: PLC0415, only where users' arrays are
    from numpy.typing import NDArray  # noqa: PLC0415

    kind: Any = np.dtype(dtype).type
    return NDArray[kind]


def message(name: str, module: str, fields: Types, defaults: Types) -> type[Message]:
    """Return the message class of a struct."""
    values = {
        # msgspec takes no list or dictionary that is not empty
        n: msgspec.field(default_factory=v.copy) if isinstance(v, list | dict) else v
        for n, v in defaults.items()
    }
    members = {"__module__": module, "__annotations__": dict(fields), **values}
    return new_class(name, (Message,), exec_body=lambda body: body.update(members))


def interface(
    name: str, module: str, methods: Iterable[tuple[str, Types, bool]]
) -> type:
    """Return an interface; a method has a name, types, and may be one-way."""
    functions = {}
    for method, types, is_oneway in methods:
        function = _function(method, types)
        functions[method] = oneway(function) if is_oneway else function
    return type(name, (), {"__module__": module, **functions})


class CppComponent(Component):
    """A component whose code is in C++."""

    _cpp_make: Make
    _cpp_called: frozenset[str]
    """What is called often, and so is found at once: timers, messages, calls."""

    def __init__(self) -> None:
        make = type(self)._cpp_make  # noqa: SLF001, of its own class
        self._cpp_functions, self._cpp_note, self._cpp_targets = make(self)
        for name in self._cpp_called:
            setattr(self, name, MethodType(self._cpp_functions[name], self))

    def __del__(self) -> None:
        """End the object in C++ first: its threads may use this one until then."""
        for name in ("_cpp_functions", "_cpp_note", *self._cpp_called):
            vars(self).pop(name, None)

    def make_proxy(self, port: str, what: str) -> Proxy:
        """Return what a required port holds: it tells C++ of each new route."""
        return _CppProxy(what, self, port)


class _CppProxy(Proxy):
    """Methods as attributes, of which the component in C++ is told."""

    def __init__(self, what: str, component: CppComponent, port: str) -> None:
        vars(self).update(_what=what, _component=component, _port=port)

    def __setattr__(self, name: str, function: object) -> None:
        note = vars(self)["_component"]._cpp_note  # noqa: SLF001, of the same kind
        note(vars(self)["_port"], name, function)
        super().__setattr__(name, function)


def component(
    name: str, module: str, declared: Mapping[str, Any], make: Make
) -> type[CppComponent]:
    """Return the class of a component, with what its POISE_COMPONENT declares."""
    marks: dict[str, Any] = {
        "published": Published,
        "required": Required,
        "provided": Provided,
    }
    annotations = {
        port: mark[type_]
        for kind, mark in marks.items()
        for port, type_ in declared[kind].items()
    }
    keeping = {port: published(latest=True) for port in declared["latest"]}
    if "parameters" in declared:
        annotations["parameters"] = declared["parameters"]
    functions: dict[str, Any] = {}
    for type_ in declared["provided"].values():
        functions |= {n: f for n, f in vars(type_).items() if inspect.isfunction(f)}
    named = [
        *functions,
        *(n for k in ("subscribed", "timers") for n, *_ in declared[k]),
    ]
    if twice := next((each for each in named if named.count(each) > 1), None):
        raise UsageError(
            f"{name}: two of its timers, inputs and methods are named '{twice}'; name "
            "each otherwise"
        )
    for port, policy, size, type_ in declared["subscribed"]:
        handler = _function(port, {"message": type_, "return": None})
        functions[port] = subscribed(**{policy: size})(handler)
    for timer, period, deadline in declared["timers"]:
        functions[timer] = every(period, deadline=deadline)(
            _function(timer, {"return": None})
        )
    hooks = {
        hook: _function(hook, {} if type_ is None else {"state": type_})
        for hook, type_ in declared["hooks"].items()
    }
    members = {
        "__module__": module,
        "__annotations__": annotations,
        "reentrant": declared.get("reentrant", False),
        "_cpp_make": staticmethod(make),
        "_cpp_called": frozenset(functions),
        **keeping,
        **functions,
        **hooks,
    }
    return type(name, (CppComponent,), members)


def _function(name: str, types: Types) -> Callable[..., Any]:
    """Return a method with these types; an instance has the code."""

    def method(self: CppComponent, *args: Any, **kwargs: Any) -> Any:  # noqa: ANN401
        return self._cpp_functions[name](self, *args, **kwargs)

    parameters = [inspect.Parameter("self", inspect.Parameter.POSITIONAL_OR_KEYWORD)]
    for parameter, type_ in types.items():
        if parameter != "return":
            kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
            parameters.append(inspect.Parameter(parameter, kind, annotation=type_))
    method.__name__ = method.__qualname__ = name
    method.__annotations__ = dict(types)
    method.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return method
