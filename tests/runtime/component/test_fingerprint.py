"""Types fit when they are the same, or built the same."""

import sys
from types import ModuleType
from typing import Any, TypeVar

import numpy as np
import pytest
from numpy.typing import NDArray
from typing_extensions import TypeAliasType

from poise.runtime.component.implementation import fingerprint
from poise.runtime.migration.state_check import describe_type

CODE = """
from __future__ import annotations
from poise import Message, oneway

class Pose(Message, frozen=True):
    x: float
    y: float

class Node(Message, frozen=True):
    next: Node | None
    poses: list[Pose]

class Poses:
    def pose(self, at: float) -> Pose: ...
    def reset(self, pose: Pose) -> None: ...
"""


@pytest.fixture
def install(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a function that makes a module and imports it under a name."""

    def import_as(name: str, code: str) -> Any:
        made = ModuleType(name)
        monkeypatch.setitem(sys.modules, name, made)
        exec(code, made.__dict__)
        return made

    return import_as


def test_a_type_that_was_imported_twice_fits_itself(install: Any) -> None:
    one, other = install("one", CODE), install("other", CODE)
    for name in ("Pose", "Node", "Poses"):
        mine, theirs = getattr(one, name), getattr(other, name)
        assert mine is not theirs
        assert fingerprint(mine) == fingerprint(theirs)


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("Pose", "y: float", "y: int"),
        ("Pose", "y: float", "z: float"),
        ("Node", "y: float", "y: int"),
        ("Node", "list[Pose]", "set[Pose]"),
        ("Poses", "at: float", "at: int"),
        ("Poses", "at: float", "when: float"),
        ("Poses", "y: float", "y: int"),
        ("Poses", "def reset", "@oneway\n    def reset"),
        ("Poses", "def reset", "def set"),
    ],
)
def test_a_type_that_is_built_otherwise_does_not_fit(
    install: Any, name: str, old: str, new: str
) -> None:
    one, other = install("one", CODE), install("other", CODE.replace(old, new))
    mine, theirs = getattr(one, name), getattr(other, name)
    assert fingerprint(mine) != fingerprint(theirs)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("Node | None", "Optional[Node]"),
        ("x: float", "x: Annotated[float, Meta(ge=0)]"),
    ],
)
def test_other_ways_to_write_a_type_and_limits_of_values_do_not_count(
    install: Any, old: str, new: str
) -> None:
    code = f"{CODE}\nfrom typing import Annotated, Optional\nfrom msgspec import Meta\n"
    one, other = install("one", code), install("other", code.replace(old, new))
    assert fingerprint(one.Node) == fingerprint(other.Node)


_SCALAR = TypeVar("_SCALAR", bound=np.generic)
_ALIAS = TypeAliasType(
    "_ALIAS", np.ndarray[tuple[Any, ...], np.dtype[_SCALAR]], type_params=(_SCALAR,)
)


@pytest.mark.parametrize(
    "written",
    [
        np.ndarray[Any, np.dtype[np.float32]],  # by NumPy 1
        np.ndarray[tuple[Any, ...], np.dtype[np.float32]],
        _ALIAS[np.float32],  # from NumPy 2.5 on
    ],
)
def test_arrays_fit_however_a_version_of_numpy_writes_their_type(written: Any) -> None:
    assert fingerprint(written) == fingerprint(NDArray[np.float32])
    assert fingerprint(written) != fingerprint(NDArray[np.float64])
    assert describe_type(written) == describe_type(NDArray[np.float32])


def test_equal_types_of_other_names_do_not_fit(install: Any) -> None:
    code = CODE + "\nclass Place(Message, frozen=True):\n    x: float\n    y: float\n"
    made = install("one", code)
    assert fingerprint(made.Pose) != fingerprint(made.Place)
