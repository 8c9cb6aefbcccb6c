"""Gives each process that runs tests what it would share with others on the machine.

A network where this user may make one, so ports and addresses of its own, and the
registry of emulated computers that belongs to a network. Without one a process shares
the machine's registry, which gives no address twice.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest

from poise.emulate import probe_host, sweep
from poise.emulate.processes import Owner
from poise.emulate.registry import FOLDER

_CLONE_NEWNET = 0x40000000
_SUFFIX = ".tests"


def enter_own_network() -> None:
    """Leave the machine's network for one of this process, if it may make one."""
    if not probe_host().has_namespaces:
        return
    folder = Path(tempfile.gettempdir())
    for registry in folder.glob(f"poise-*{_SUFFIX}"):
        _remove_if_killed(registry)
    # `os.unshare` is there from Python 3.12 on
    if ctypes.CDLL(None).unshare(_CLONE_NEWNET):
        return  # forbidden, as some sandboxes do
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True, timeout=10)
    os.environ[FOLDER] = str(folder / f"{Owner.this()}{_SUFFIX}")


def leave() -> None:
    """Remove this process's registry."""
    if (registry := os.environ.get(FOLDER, "")).endswith(_SUFFIX):
        shutil.rmtree(registry, ignore_errors=True)


def _remove_if_killed(registry: Path) -> None:
    _, pid, started = registry.name.removesuffix(_SUFFIX).split("-")
    if Owner(int(pid), int(started)).is_alive():
        return
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.suppress(FileNotFoundError),  # another process removes it as well
    ):
        patch.setenv(FOLDER, str(registry))
        sweep()
    shutil.rmtree(registry, ignore_errors=True)
