"""What all tests share."""

from __future__ import annotations

import contextlib
import os
import signal
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from poise.emulate import sweep
from poise.emulate.registry import registered
from poise.session.folders import scratch_folder
from tests import busy, machine, order, quick
from tests.command import Poise, run_poise
from tests.waiting import LIMIT, wait_until

# an example that takes long on a busy machine is no fault
settings.register_profile(
    "poise",
    max_examples=50,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile("soak", settings.get_profile("poise"), max_examples=1000)
settings.load_profile("poise")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let a soak ask for another order each time."""
    parser.addoption("--shuffle", type=int, metavar="SEED", help="run in random order")


def pytest_configure(config: pytest.Config) -> None:
    """Add what all runs hold."""
    if config.getoption("markexpr") != "wheels":  # those fetch what they install
        machine.enter_own_network()
    for plugin in (busy, order, quick):
        config.pluginmanager.register(plugin)
    # a shell's background job ignores Ctrl-C, and `nohup` a hang-up; so would all that
    # tests start
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.fixture
def poise(tmp_path: Path) -> Poise:
    """Return what runs `poise` in the test's folder."""
    return partial(run_poise, cwd=tmp_path)


@pytest.fixture(scope="session", autouse=True)
def _leaves_nothing(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Hold that no process, file or emulated computer outlives all tests."""
    tmp_path_factory.getbasetemp()  # pytest keeps its own, elsewhere
    with (
        pytest.MonkeyPatch.context() as patch,
        tempfile.TemporaryDirectory() as name,
        tempfile.TemporaryDirectory() as state,
    ):
        place = Path(name)
        place.chmod(0o755)  # some tests are another user
        Path(state).chmod(0o777)
        patch.setenv("TMPDIR", name)
        patch.setenv("XDG_STATE_HOME", state)
        patch.setenv("XDG_DATA_HOME", state)  # a person's keys are another robot's
        patch.setattr(tempfile, "tempdir", None)
        patch.delenv("XDG_RUNTIME_DIR", raising=False)  # else robots' sockets lie there
        yield
        with contextlib.suppress(AssertionError):  # what follows names them
            wait_until(lambda: not _processes(place), LIMIT, every=0.01)
        # as the next run does, for tests that kill one
        sweep()
        with scratch_folder("poise-run-"), scratch_folder("poise-agent-"):
            pass
        left = [*_processes(place), *_files(place), *_emulations(place)]
        machine.leave()
        assert left == []


def _processes(place: Path) -> list[str]:
    """Return the processes that have their temporary files in a folder, for people."""
    mark, found = f"TMPDIR={place}".encode(), []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            words = (process / "environ").read_bytes().split(b"\0")
            if any(word.startswith(mark) for word in words):
                stat = (process / "stat").read_text().rpartition(")")[2].split()
                command = (process / "cmdline").read_bytes().replace(b"\0", b" ")
                found.append(f"{process.name} of {stat[1]}: {command.decode()[:300]}")
        except OSError:  # it has ended, or is another user's
            continue
    return found


def _files(place: Path) -> list[Path]:
    desk = place / f"poise-{os.getuid()}"  # stays, for the sockets of robots that run
    return [*(path for path in place.iterdir() if path != desk), *desk.glob("*")]


def _emulations(place: Path) -> list[str]:
    return [
        layout.run
        for layout in registered()
        if any(computer.folder.startswith(str(place)) for computer in layout.computers)
    ]
