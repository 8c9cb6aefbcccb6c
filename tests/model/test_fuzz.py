"""Whatever stands in a robot file: a robot, or a RobotError with places."""

import tempfile
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from poise.errors import RobotError
from poise.model import load
from poise.model.robot import Robot

GOOD: dict[str, Any] = {
    "robot": "r",
    "computers": {"main": {"cpu": 1, "memory": "1 GiB", "reserve": {"cpu": 0.1}}},
    "devices": {"laser": {"computer": "main"}},
    "links": [{"between": ["main", "main"], "bandwidth": "100 Mbit/s"}],
    "architectures": {
        "nav": {
            "function": "f",
            "layer": "reactive",
            "home": "main",
            "components": {
                "a": {"devices": ["laser"], "only": ["main"], "parameters": {"x": 1}},
                "b": {"command": "x y", "ports": {"p": {"publishes": "m:C"}}},
            },
            "connectors": [{"between": ["b.p", "a.q"], "message": "3 kB"}],
        }
    },
    "chains": {"c": {"through": ["a", "b"], "deadline": "200 ms"}},
    "tasks": {"t": {"actions": [{"name": "x", "functions": ["f"]}]}},
    "objective": {"weights": {"cpu": 1}},
    "together": [["a", "b"]],
    "apart": [["a", "b"]],
    "simulator": {"command": ["x"]},
}

scalars = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=20)
    | st.sampled_from(["main", "a", "b", "f", "laser", "5%", "1 MiB", "1e999", "a.b"])
)
values = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["cpu", "a", "between", "components"]) | st.text(),
            inner,
            max_size=3,
        )
    ),
    max_leaves=8,
)


def try_to_load(content: bytes) -> None:
    """Load a file with `content`; nothing but a RobotError may come out."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "robot.yaml")
        path.write_bytes(content)
        result = robot_or_error(path)
        if isinstance(result, RobotError):
            assert result.problems
            assert all(p.file == str(path) and p.message for p in result.problems)
            assert str(result).encode("utf-8")


def robot_or_error(path: Path) -> Robot | RobotError:
    try:
        return load(path)
    except RobotError as error:
        return error


@given(st.binary(max_size=300))
def test_survives_any_bytes(content: bytes) -> None:
    try_to_load(content)


@pytest.mark.slow
@given(st.text(alphabet="ab:[]{},-?&*!|>'\"%@`#\\ \n\t0~<\x85", max_size=60))
def test_survives_any_text_of_yaml_signs(text: str) -> None:
    try_to_load(text.encode())


@pytest.mark.slow
@given(values)
def test_survives_any_yaml(value: object) -> None:
    try_to_load(yaml.safe_dump(value, allow_unicode=True).encode("utf-8", "replace"))


@st.composite
def spoiled(draw: st.DrawFn) -> Any:
    """Draw a good robot in which a few values were replaced or added."""
    return draw(_spoil(GOOD))


def _spoil(part: Any) -> st.SearchStrategy[Any]:
    """Keep most of `part`; replace something here and there."""
    if isinstance(part, dict):
        kept: st.SearchStrategy[Any] = st.fixed_dictionaries(
            {key: _spoil(value) for key, value in part.items()}
        )
    elif isinstance(part, list):
        kept = st.tuples(*map(_spoil, part)).map(list)
    else:
        kept = st.just(part)
    return st.integers(0, 40).flatmap(lambda dice: kept if dice else values)


@pytest.mark.slow
@given(spoiled())
def test_survives_a_spoiled_robot(value: object) -> None:
    try_to_load(yaml.safe_dump(value, allow_unicode=True).encode("utf-8", "replace"))


@pytest.mark.parametrize(
    "content",
    [
        b"[" * 5000,
        b"{a: " * 5000,
        b"- " * 5000,
        b"? " * 5000,
        b"a: &a [*a, *a]",
        b"robot: " + b"9" * 100_000,
        b"robot: r\ncomputers: {m: {cpu: " + b"9" * 5000 + b", memory: 1e400}}",
        b"%YAML 9.9\n---\na",
        b"\xef\xbb\xbfrobot: r",
        b"\xff\xfer\0o\0",
        b"a: 2001-99-99",
        b"<<: *x",
        b"<<: [1]\na: 1",
    ],
)
def test_survives_known_nasty_files(content: bytes) -> None:
    try_to_load(content)
