"""The log of a process in the background stays small, whoever writes to it."""

from __future__ import annotations

import stat
import subprocess
import sys
from pathlib import Path

import pytest

from poise.session.launch.background_log import LARGEST, log_of

WRITING = """
import subprocess, sys
from poise.session.launch.background_log import keep_log_small

def write(text):
    code = "import sys; sys.stdout.write(sys.argv[1] * 100_000)"
    subprocess.run([sys.executable, "-c", code, text], check=True)

for text in "abcdef":
    write(f"{text * 9}\\n")
    keep_log_small()
write("end")
"""


def test_nobody_else_reads_what_components_print(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert stat.S_IMODE(log_of("twice").stat().st_mode) == 0o600


@pytest.mark.slow
def test_what_processes_append_to_a_log_does_not_fill_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That of emulated computers had all that components ever printed."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    log = log_of("twice")
    _run(log)
    before = log.with_suffix(".before.log")
    assert log.read_text().endswith("end")
    assert before.stat().st_size == LARGEST
    assert log.stat().st_size <= 2 * LARGEST
    assert stat.S_IMODE(before.stat().st_mode) == 0o600


@pytest.mark.slow
def test_a_file_of_somebody_else_keeps_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    mine = tmp_path / "mine.log"
    _run(mine)
    assert mine.stat().st_size > 5 * LARGEST
    assert list(tmp_path.iterdir()) == [mine]


def _run(log: Path) -> None:
    with log.open("ab") as output:
        subprocess.run([sys.executable, "-c", WRITING], stdout=output, check=True)
