"""Whether a state fits what is to restore it, by the names of its fields."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import cache
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

from msgspec import Struct

from poise.errors import UsageError
from poise.runtime.component.component import Component
from poise.runtime.component.implementation import fingerprint
from poise.wire.codec import codec, without_alias

_WAYS_OUT = "let `poise replace` map it with --adapt, or drop it with --fresh"


@cache
def describe_type(type_: Any) -> str:  # noqa: ANN401, any type
    """Return the fields of a message class; of `list[float]` only that it is a list."""
    type_ = without_alias(type_)
    type_ = get_origin(type_) or type_
    made_of = fingerprint(type_)
    if isinstance(type_, type) and issubclass(type_, Struct):
        assert isinstance(made_of, tuple)  # noqa: S101, of a message class
        fields = made_of[1]  # the class's own name does not count
        return _fields_in_words(fields)
    return str(made_of)


def _fields_in_words(fields: Iterable[tuple[str, Any]]) -> str:
    return f"({', '.join(f'{name}: {_in_words(of)}' for name, of in fields)})"


def _in_words(made_of: Any) -> str:  # noqa: ANN401, a fingerprint
    """Return what a field's type is made of as it is written in code."""
    if isinstance(made_of, str):
        return made_of
    name, parts = made_of
    generic = re.fullmatch(r"<class '(.*)'>|(typing\..*)", name)
    if generic is None:
        is_message = all(len(part) == 2 for part in parts)  # noqa: PLR2004, a pair
        return f"{name}{_fields_in_words(parts)}" if is_message else name
    if "Union" in name:
        return " | ".join(map(_in_words, parts))
    return f"{generic[1] or generic[2]}[{', '.join(map(_in_words, parts))}]"


def check_fits(
    described: str,
    taken: Any,  # noqa: ANN401, any type
    by: str,
    remedy: str = f"let `snapshot` return that, or {_WAYS_OUT}",
) -> None:
    """Raise UsageError when a described state is not what method `by` takes."""
    is_union = get_origin(taken) in {Union, UnionType}
    options = get_args(taken) if is_union else (taken,)
    if taken is Any or any(describe_type(option) == described for option in options):
        return
    raise UsageError(
        f"the state is {described}, but {by} takes "
        f"{' or '.join(map(describe_type, options))}: {remedy}"
    )


def check_restores(component: Component) -> None:
    """Raise UsageError when a component would lose the state that it is given."""
    code = type(component)
    if code.restore is Component.restore:
        raise UsageError(
            f"{code.__qualname__} has no `restore`, so the state would be lost: write "
            f"`restore`, or {_WAYS_OUT}"
        )


def check_adapted(
    component: Component,
    name: str,
    states: tuple[Mapping[str, Any], Mapping[str, Any]],
    sources: Collection[str],
) -> None:
    """Raise UsageError when `adapt` takes or makes other states than there are."""
    before, after = states
    unknown = ", ".join(sorted(before.keys() - set(sources)))
    if unknown:
        raise UsageError(
            f"--adapt takes the state of '{unknown}', which is not replaced "
            f"({', '.join(sorted(sources))} are)"
        )
    takes_state = type(component).restore is not Component.restore
    if takes_state and name not in after:
        raise UsageError(
            f"--adapt makes no state for '{name}', only for {', '.join(after)}: add "
            f"the field '{name}', or begin without state by --fresh"
        )
    if name in after:
        check_restores(component)


def check_result(adapt: Callable[[Any], Any], component: Component) -> None:
    """Raise UsageError when `adapt` makes another state than a component restores."""
    check_restores(component)
    result = get_type_hints(adapt).get("return")
    if result is None:
        raise UsageError(f"{adapt.__qualname__} must say which type it returns")
    by = f"{type(component).__qualname__}.restore"
    check_fits(describe_type(result), type_taken_by(component.restore), by)


def check_state(component: type[Component]) -> None:
    """Raise UsageError when what `restore` takes has no type, or one of no message."""
    for name in ("restore", "restore_delta"):
        method = getattr(component, name)
        if method is not getattr(Component, name):
            taken = type_taken_by(method.__get__(component))
            try:
                codec(taken)
            except TypeError as error:
                raise UsageError(f"{method.__qualname__}: {error}") from None


def type_taken_by(method: Any) -> Any:  # noqa: ANN401, a user's method
    """Return the type that a method's parameter is annotated with."""
    name = next(iter(inspect.signature(method).parameters), None)
    if name is None:
        raise UsageError(f"{method.__qualname__} must take one argument: the state")
    hints = get_type_hints(method)
    if name not in hints:
        raise UsageError(
            f"{method.__qualname__}: parameter '{name}' must say the state's type"
        )
    return hints[name]


def types_of(
    adapt: Callable[[Any], Any],
) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """Return which states a function takes, and which it gives: component -> type."""
    hints = get_type_hints(adapt)
    messages = []
    for name in (*inspect.signature(adapt).parameters, "return"):
        type_ = hints.get(name)
        if not (isinstance(type_, type) and issubclass(type_, Struct)):
            raise UsageError(
                f"{adapt.__qualname__}: its parameter and its result must be message "
                "classes with a field for each component whose state it takes or gives"
            )
        types = get_type_hints(type_)
        messages.append({field: types[field] for field in type_.__struct_fields__})
    if len(messages) != 2:  # noqa: PLR2004, one in, one out
        raise UsageError(f"{adapt.__qualname__} must take one argument: the old states")
    return messages[0], messages[1]
