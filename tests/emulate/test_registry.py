"""Emulations on disk."""

from __future__ import annotations

import os
import resource
import shutil
from collections.abc import Collection
from pathlib import Path

import pytest
from msgspec.structs import replace

from poise.emulate import registry, sweep
from poise.emulate.cgroups import Groups, Probe
from poise.emulate.registry import EmulationLayout, lay_out
from poise.errors import RunError
from poise.model.robot import Robot
from poise.wire import robots_here

pytestmark = pytest.mark.usefixtures("own_registry")


def test_another_process_reads_what_was_registered(
    two_computers: Robot, tmp_path: Path
) -> None:
    host = Probe(
        cpus=(0, 1),
        groups=Groups(),
        tools=frozenset({"ip", "tc", "nsenter"}),
        may_make_namespaces=True,
    )
    layout = registry.register(lambda _: lay_out(two_computers, tmp_path, host, 0))
    assert list(registry.registered()) == [layout]
    assert sweep() == []  # this process, its owner, lives


@pytest.mark.parametrize("may_make_namespaces", [True, False])
def test_two_that_are_laid_out_at_once_get_addresses_of_their_own(
    two_computers: Robot, tmp_path: Path, *, may_make_namespaces: bool
) -> None:
    """Nothing of the first one is there yet, and both would begin at one number."""
    host = Probe(
        cpus=(0, 1),
        groups=Groups(),
        tools=frozenset({"ip", "tc", "nsenter"}),
        may_make_namespaces=may_make_namespaces,
    )

    def laid_out(run: str) -> EmulationLayout:
        def lay(others: Collection[str]) -> EmulationLayout:
            made = lay_out(two_computers, tmp_path, host, 0, taken=others)
            return replace(made, run=run)

        return registry.register(lay)

    one, other = laid_out("one"), laid_out("other")
    addresses = {c.address for each in (one, other) for c in each.computers}
    assert len(addresses) == 4
    begins = 3 if may_make_namespaces else 2
    nets = {tuple(address.split(".")[:begins]) for address in addresses}
    assert len(nets) == 2


def test_an_entry_of_another_version_is_an_error_that_names_it(
    own_registry: Path,
) -> None:
    (own_registry / "poise-1-2-0.emulation").write_text("{}")
    with pytest.raises(RunError, match=r"poise-1-2-0\.emulation: .*owner.*remove"):
        sweep()


def test_a_folder_that_cannot_be_made_is_named_with_a_way_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(registry.FOLDER, str(tmp_path / "nothing/emulations"))
    with pytest.raises(RunError, match=r"nothing/emulations.*: set XDG_RUNTIME_DIR"):
        sweep()


def test_a_full_disk_is_an_error_that_leaves_nothing(
    two_computers: Robot, tmp_path: Path, own_registry: Path
) -> None:
    host = Probe(
        cpus=(0,), groups=Groups(), tools=frozenset(), may_make_namespaces=False
    )
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, limits[1]))
    try:
        with pytest.raises(RunError, match=r"cannot be written down: .*File too large"):
            registry.register(lambda _: lay_out(two_computers, tmp_path, host, 0))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not list(own_registry.glob("poise-*"))


def test_a_manager_and_emulations_may_have_one_folder(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As those of a user who may not write to /run."""
    monkeypatch.delenv(registry.FOLDER)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert robots_here.make_folder() == registry.registry()
    monkeypatch.setattr(registry, "_LOCK_LIMIT", 0.0)
    with registry.locked():
        pass


def test_two_processes_may_remove_the_same_emulation(
    two_computers: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    host = Probe(
        cpus=(0, 1), groups=Groups(), tools=frozenset(), may_make_namespaces=False
    )
    layout = lay_out(two_computers, tmp_path, host, 0)
    for computer in layout.computers:
        Path(computer.folder, "keys").mkdir(parents=True)
    rmtree = shutil.rmtree

    def raced(folder: str) -> None:
        """Lose the first file to another process."""
        monkeypatch.setattr(shutil, "rmtree", rmtree)
        raise FileNotFoundError(folder)

    monkeypatch.setattr(shutil, "rmtree", raced)
    registry.remove(layout)
    assert not any(Path(computer.folder).exists() for computer in layout.computers)
