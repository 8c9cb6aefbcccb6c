"""Robots to emulate, and what a host must have for the real tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from poise.emulate import probe_host
from poise.emulate.registry import FOLDER
from poise.model.robot import Computer, Link, Robot


@pytest.fixture
def two_computers() -> Robot:
    """Two computers of 0.3 and 0.2 host cores, joined by a 100 Mbit/s link."""
    return Robot(
        name="tiny",
        computers=(
            Computer(name="brain", capacity={"cpu": 0.3, "memory": 512e6}),
            Computer(name="legs", capacity={"cpu": 0.4, "memory": 256e6}, speed=0.5),
        ),
        links=(Link(between=("brain", "legs"), bandwidth=12.5e6),),
    )


@pytest.fixture
def own_registry(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """Give a test that uses no address a registry without what others left or lock."""
    folder = tmp_path_factory.mktemp("registry")
    monkeypatch.setenv(FOLDER, str(folder))
    return folder


@pytest.fixture
def needs_limits() -> None:
    """Skip where this user may not limit processes."""
    missing = {"cpu", "cpuset", "memory"} - probe_host().groups.controls
    if missing:
        pytest.skip(f"no cgroup to write to with {', '.join(sorted(missing))}")


@pytest.fixture
def needs_namespaces() -> None:
    """Skip where this user may not make networks."""
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))
