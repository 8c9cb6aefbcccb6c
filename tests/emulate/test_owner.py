"""Telling a living owner from a dead one."""

from __future__ import annotations

import os
import subprocess

import msgspec
import pytest

from poise.emulate.processes import Owner, _started


def test_this_process_lives() -> None:
    assert Owner.this().is_alive()


def test_later_process_of_the_same_number_is_not_the_owner() -> None:
    this = Owner.this()
    assert not msgspec.structs.replace(this, started=this.started - 1).is_alive()


@pytest.mark.slow
def test_process_that_ended_but_was_not_waited_for_is_dead() -> None:
    with subprocess.Popen(["cat"], stdin=subprocess.PIPE) as cat:
        owner = Owner(cat.pid, _started(cat.pid) or 0)
        assert owner.is_alive()
        assert cat.stdin
        cat.stdin.close()
        os.waitid(os.P_PID, cat.pid, os.WEXITED | os.WNOWAIT)
        assert not owner.is_alive()
