"""A process that a component forks waits for nothing that only its parent has."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.waiting import LIMIT

pytestmark = pytest.mark.slow

FORKS = """
import os, signal, sys
from pathlib import Path
{}
if not (child := os.fork()):
    signal.alarm(10)
    again()
    os._exit(0)
sys.exit(os.waitpid(child, 0)[1])
"""
STARTS_A_CALL = """
from poise.runtime.component.started_calls import StartedCalls
calls = StartedCalls("c", lambda do: do())

def again():
    assert calls.start(lambda: 1).result() == 1

again()
"""
WRITES = """
from poise.runtime.hosting.output import keep_output
keep_output(Path(sys.argv[1]), "hall")

def again():
    print("a child's", flush=True)

sys.stdout._file._lock.acquire()
"""


@pytest.mark.parametrize("code", [STARTS_A_CALL, WRITES], ids=["starts", "writes"])
def test_a_forked_process_does_it_again(code: str, tmp_path: Path) -> None:
    # Python warns from 3.12 on that other threads do not go on in a forked process
    argv = [sys.executable, "-W", "ignore::DeprecationWarning"]
    argv += ["-c", FORKS.format(code), str(tmp_path)]
    ended = subprocess.run(argv, stderr=subprocess.PIPE, timeout=LIMIT, check=False)
    assert (ended.returncode, ended.stderr) == (0, b"")
