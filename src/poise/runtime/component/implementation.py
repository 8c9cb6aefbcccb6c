"""Finds the classes that a robot file names."""

from __future__ import annotations

import importlib
import inspect
import re
import sys
from collections.abc import Callable, Hashable, Iterable, Mapping
from types import ModuleType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

from msgspec import Struct

from poise.errors import RobotError, did_you_mean, listed
from poise.runtime.component import ports
from poise.runtime.component.component import Component
from poise.runtime.component.error_report import brief_traceback
from poise.runtime.component.ports import is_oneway, methods_of
from poise.wire.codec import without_alias


def find(implementation: str, folder: str) -> type[Component]:
    """Return the component class ``package.module:Class``."""
    class_ = find_type(implementation, folder)
    if not issubclass(class_, Component):
        raise RobotError(
            f"'{implementation}' is not a component: class {class_.__qualname__} must "
            "inherit from poise.Component"
        )
    return class_


def find_for(
    implementation: str, parameters: Mapping[str, Any], folder: str
) -> type[Component]:
    """Return the class to run; Poise's own may have ports by their parameters."""
    class_ = find(implementation, folder)
    special = getattr(class_, "__poise_specialised__", None)
    return special(parameters, folder) if special else class_


def find_type(reference: str, folder: str) -> type[Any]:
    """Return any class ``package.module:Class``; raises as `find` does."""
    type_ = _find_any(reference, folder)
    if not isinstance(type_, type):
        raise RobotError(
            f"'{reference}' is of type {type(type_).__name__}, not a class"
        )
    return type_


def find_function(reference: str, folder: str = "") -> Callable[[Any], Any]:
    """Return any function ``package.module:function``; raises as `find` does."""
    function = _find_any(reference, folder, "function")
    if not callable(function):
        raise RobotError(
            f"'{reference}' is of type {type(function).__name__}, not a function"
        )
    return function  # type: ignore[no-any-return]


def _find_any(reference: str, folder: str, kind: str = "class") -> Any:  # noqa: ANN401, whatever it names
    module_name, _, path = reference.partition(":")
    attribute: Any = load_module(module_name, folder)
    for name in path.split("."):
        if not hasattr(attribute, name):
            raise RobotError(_no_attribute(reference, attribute, name, kind))
        attribute = getattr(attribute, name)
    return attribute


def search_also(folders: Iterable[str]) -> None:
    """Put folders last on ``sys.path`` for good: the repository's."""
    new = [folder for folder in folders if folder not in sys.path]
    if new:
        sys.path += new
        importlib.invalidate_caches()


def search_first(folder: str) -> None:
    """Put a folder first on ``sys.path`` for good, unless it is there."""
    if folder not in sys.path:
        sys.path.insert(0, folder)
        importlib.invalidate_caches()


def load_module(name: str, folder: str) -> ModuleType:
    """Import a module; RobotError, caused by what it raised, when that fails."""
    if folder:
        search_first(folder)
    failed = f"the module '{name}' cannot be imported"
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is not None and f"{name}.".startswith(f"{error.name}."):
            raise RobotError(
                f"there is no module '{error.name}': it is looked for in {folder!r} "
                "first, then among the installed packages, then in the folders of "
                f"`repository`{_if_of_python(name)}"
            ) from None
        raise RobotError(f"{failed}: {brief_traceback(error)}") from error
    except KeyboardInterrupt:
        raise
    # The module is the user's: whatever it raises is told with its traceback.
    except BaseException as error:
        # what a module in C++ raises is the cause of an error of nanobind's
        is_wrapped = str(error).endswith("while initializing the extension.")
        raised = (error.__cause__ if is_wrapped else None) or error
        _note_parameters(raised)
        raise RobotError(f"{failed}: {brief_traceback(raised)}") from error


def _note_parameters(error: BaseException) -> None:
    """Say what a decorator of Poise's takes, when it was given something else."""
    name, found, _ = str(error).partition("() got an unexpected keyword argument")
    if found and hasattr(ports, name):
        known = inspect.signature(getattr(ports, name)).parameters
        error.add_note(f"{name} takes {listed(known)}")


def _no_attribute(
    reference: str,
    holder: Any,  # noqa: ANN401, module or class
    name: str,
    kind: str,
) -> str:
    is_class = kind == "class"
    is_kind = inspect.isclass if is_class else inspect.isfunction
    others = [
        other
        for other, value in vars(holder).items()
        if is_kind(value)
        and holder.__name__ in (value.__module__, value.__qualname__.split(".")[0])
    ]
    return (
        f"'{reference}': {holder.__name__} has no {kind} '{name}'"
        f"{did_you_mean(name, others)}; "
        f"{'classes' if is_class else 'functions'}: {listed(others)}"
        f"{_if_of_python(reference)}"
    )


def _if_of_python(reference: str) -> str:
    """Return what to do about a module that has a name of Python's own, in words."""
    name = re.split("[.:]", reference)[0]
    if name not in sys.stdlib_module_names:
        return ""
    return f"; '{name}' is a module of Python's: if you have one, give it another name"


Seen = tuple[type, ...]


def fingerprint(type_: Any) -> Hashable:  # noqa: ANN401, any type
    """Return what a type is made of; types with equal fingerprints fit each other.

    Limits of values do not count, nor how versions of Python and NumPy write a type.
    """
    return _fingerprint(type_, ())


def _fingerprint(type_: Any, seen: Seen) -> Hashable:  # noqa: ANN401, any type
    type_ = without_alias(type_)
    origin, arguments = get_origin(type_), get_args(type_)
    if origin is Annotated:
        return _fingerprint(arguments[0], seen)
    if origin is not None:
        if origin.__name__ == "ndarray":
            arguments = arguments[1:]  # any shape, which NumPy writes in several ways
        inner = tuple(_fingerprint(argument, seen) for argument in arguments)
        return (str(UnionType if origin is Union else origin), inner)
    if not isinstance(type_, type) or type_ in seen:
        return getattr(type_, "__qualname__", repr(type_))
    if issubclass(type_, Struct):
        return (type_.__qualname__, _fields(type_, (*seen, type_)))
    if type_.__module__ == "builtins" or not methods_of(type_):
        return type_.__qualname__
    return (type_.__qualname__, _methods(type_, (*seen, type_)))


def _fields(message: type[Struct], seen: Seen) -> Hashable:
    hints = get_type_hints(message, include_extras=True)
    return tuple(
        (name, _fingerprint(hints[name], seen)) for name in message.__struct_fields__
    )


def _methods(interface: type, seen: Seen) -> Hashable:
    described = []
    for name in methods_of(interface):
        method = getattr(interface, name)
        hints = get_type_hints(method)
        takes = tuple(
            (parameter, _fingerprint(hints.get(parameter), seen))
            for parameter in list(inspect.signature(method).parameters)[1:]
        )
        gives = _fingerprint(hints.get("return"), seen)
        described.append((name, takes, gives, is_oneway(interface, name)))
    return tuple(sorted(described, key=lambda entry: entry[0]))
