"""Emulations on disk."""

from __future__ import annotations

from pathlib import Path

import pytest

from poise.emulate import registry, sweep
from poise.emulate.cgroup.groups import Groups
from poise.emulate.layout import lay_out
from poise.emulate.probe import Probe
from poise.errors import RunError
from poise.model.robot import Robot


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Use a registry that no other process sees."""
    folder = tmp_path / "registry"
    folder.mkdir()
    monkeypatch.setattr(registry, "registry", lambda: folder)
    return folder


def test_another_process_reads_what_was_registered(
    two_computers: Robot, tmp_path: Path
) -> None:
    host = Probe(
        cpus=(0, 1),
        groups=Groups(),
        tools=frozenset({"ip", "tc", "nsenter"}),
        may_make_namespaces=True,
    )
    layout = lay_out(two_computers, tmp_path, host, 0)
    registry.register(layout)
    assert list(registry.registered()) == [layout]
    assert sweep() == []  # this process, its owner, lives


def test_an_entry_of_another_version_is_an_error_that_names_it(folder: Path) -> None:
    (folder / "poise-1-2-0.emulation").write_text("{}")
    with pytest.raises(RunError, match=r"poise-1-2-0\.emulation: .*owner.*remove"):
        sweep()
