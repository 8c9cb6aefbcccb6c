"""What is refused of an emulated computer says what ends the fault that is there."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest

from poise.emulate import InjectedFault, emulated_set
from poise.emulate.registry import FaultKind, KeptSet
from poise.errors import UsageError
from tests.waiting import wait_long


@pytest.mark.parametrize(
    ("kind", "on", "command"),
    [
        ("cut", ("left", "right"), "heal left right"),
        ("slow", ("left", "right"), "heal left right"),
        ("crashed", ("left",), "boot left"),
        ("frozen agent", ("left",), "boot left"),
        ("load", ("left",), "load left --cpu 0"),
    ],
)
def test_each_fault_says_what_ends_it(
    kind: FaultKind, on: tuple[str, ...], command: str
) -> None:
    fault = InjectedFault(kind=kind, on=on, since=0.0)
    assert fault.way_out == f"`poise emulate {command}` ends it"
    said = emulated_set._said([fault])
    assert str(fault) in said
    assert command in said


def test_a_cut_without_namespaces_is_refused_for_that_reason_alone() -> None:
    why = "namespaces and shaped links: no root"
    without = ("quota: no root", why, "links of one's own: not in namespaces")
    state = KeptSet(robot="any", hardware="", without=without, no_network=why)
    kept = Mock(layout=Mock(network=None), state=lambda: state)
    with pytest.raises(UsageError) as refused:
        emulated_set.EmulatedSet._network(kept)
    assert str(refused.value) == (
        "this machine does not emulate the network: without namespaces and shaped "
        "links: no root"
    )


@pytest.mark.slow
@pytest.mark.parametrize("what", ["agent", "witness", "status"])
def test_a_witness_is_frozen_as_an_agent_is(tmp_path: Path, what: str) -> None:
    (tmp_path / "sitecustomize.py").write_text("import time\ntime.sleep(60)\n")
    command = [sys.executable, "-m", "poise", what, "left"]
    with subprocess.Popen(command, env={"PYTHONPATH": str(tmp_path)}) as process:
        wait_long(Path(f"/proc/{process.pid}/cmdline").read_bytes)
        is_agent = emulated_set._is_agent(process.pid, os.getpid())
        process.kill()
    assert is_agent == (what != "status")
