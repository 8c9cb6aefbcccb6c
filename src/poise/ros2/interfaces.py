"""Finds the classes of ROS 2's messages, services and actions by their names."""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from poise.errors import RobotError, did_you_mean, listed


def interface(name: str) -> Any:  # noqa: ANN401, a generated class
    """Return the class of ``package/msg/Name``, or RobotError with what there is."""
    package, kind, class_ = name.split("/")
    try:
        module = importlib.import_module(f"{package}.{kind}")
    except ModuleNotFoundError:
        known = sorted({each.split("/")[0] for each in _all("*", kind)})
        raise RobotError(
            f"there is no '{name}': no package '{package}' has {kind}"
            f"{did_you_mean(package, known)}; packages: {listed(known)}"
        ) from None
    names = [n for n in vars(module) if n[0].isupper()]
    if class_ not in names:
        raise RobotError(
            f"package '{package}' has no {kind} '{class_}'{did_you_mean(class_, names)}"
        )
    return getattr(module, class_)


def named(class_: str, kind: str) -> str:
    """Return the only interface called `class_`, as ``package/msg/Name``."""
    found = sorted(set(_all(_snake(class_), kind)))
    names = [f"{each.split('/')[0]}/{kind}/{class_}" for each in found]
    if len(names) == 1:
        return names[0]
    reason = f"several are called so: {listed(names)}" if names else "none is called so"
    raise RobotError(
        f"the type in ROS 2 of '{class_}' is not clear, for {reason}: write "
        f"`type: package/{kind}/Name`"
    )


def _all(snake: str, kind: str) -> Iterator[str]:
    """Yield ``package/file`` of the generated modules with a name."""
    for folder in map(Path, sys.path):
        if folder.is_dir():
            for file in folder.glob(f"*/{kind}/_{snake}.py"):
                yield f"{file.parts[-3]}/{file.stem}"


def _snake(name: str) -> str:
    """Return a class's name as its generated module has it."""
    name = re.sub(r"(.)([A-Z][a-z]+)", r"\1_\2", name)
    return re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", name).lower()
