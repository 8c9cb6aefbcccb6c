"""Containers that outlive their agent, and the agent that adopts them."""

from __future__ import annotations

import errno
import os
import signal
import socket
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NoReturn

import pytest

from poise.clock import SystemClock
from poise.runtime.agent import agent_files
from poise.runtime.agent.agent_files import AgentFolder
from poise.runtime.agent.surroundings import AgentState
from poise.runtime.container.agent_link import Orphan, hand_over
from poise.runtime.execution.counters import new_memory
from poise.runtime.supervision.adopted_containers import ADOPT_LIMIT, AdoptedContainers
from poise.testing import VirtualClock
from poise.wire.address import agent_path, socket_path
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.request_records import Claim, Refused, checkpoint_path
from tests.processes import children_of
from tests.runtime.agent.test_agent import Manager, manager_id, wait_gone

pytestmark = pytest.mark.slow


@pytest.fixture
def manager() -> Iterator[Manager]:
    with tempfile.TemporaryDirectory() as folder:  # pytest's are too long for sockets
        manager = Manager(Path(folder))
        yield manager
        manager.close()


def kill_agent(manager: Manager) -> None:
    manager.wait_kept()  # containers run before the disk has it
    manager.process.kill()
    manager.process.wait()
    assert manager.process.stderr
    manager.process.stderr.close()  # containers have it, too: it does not end


def restart_agent(manager: Manager) -> None:
    kill_agent(manager)
    manager.process = manager.start_agent()


@pytest.mark.parametrize("with_zygote", [True, False])
def test_the_next_agent_adopts_what_a_killed_one_left(
    manager: Manager, *, with_zygote: bool
) -> None:
    manager.deploy("quiet", "calm")
    pids = {name: manager.wait_active(name).pid for name in ("quiet", "calm")}
    if not with_zygote:
        manager.wait_kept()
        (zygote,) = children_of(manager.process.pid)
        os.kill(manager.process.pid, signal.SIGSTOP)  # else it ends by itself
        os.kill(zygote, signal.SIGKILL)
    restart_agent(manager)
    assert {name: manager.wait_adopted(name).pid for name in pids} == pids
    status = manager.wait_active_status("quiet")
    assert len(status.took_over or ()) == 2
    assert status.manager == manager_id("first")  # it obeys whom the last one obeyed
    assert not manager.faults(status)


def test_an_adopted_container_is_restarted_when_it_dies_and_stopped_when_asked(
    manager: Manager,
) -> None:
    manager.deploy("quiet")
    container = manager.wait_active("quiet")
    restart_agent(manager)
    manager.wait_adopted("quiet")
    os.kill(container.pid, signal.SIGKILL)
    manager.wait_active("quiet", but_not=container.pid)
    restart_agent(manager)  # now the parents of its containers are two dead agents
    container = manager.wait_adopted("quiet")
    manager.deploy()
    manager.wait_for(lambda status: not status.containers)
    wait_gone(container.pid)


def test_what_died_with_the_agent_starts_anew_without_a_manager(
    manager: Manager,
) -> None:
    manager.deploy("quiet", "calm")
    pids = {name: manager.wait_active(name).pid for name in ("quiet", "calm")}
    kill_agent(manager)
    os.kill(pids["quiet"], signal.SIGKILL)
    wait_gone(pids["quiet"])
    manager.process = manager.start_agent()
    assert manager.wait_adopted("calm").pid == pids["calm"]
    manager.wait_active("quiet", but_not=pids["quiet"])


def test_one_that_does_not_ask_is_killed_before_another_is_started(
    manager: Manager,
) -> None:
    manager.deploy("quiet")
    container = manager.wait_active("quiet")
    os.kill(container.pid, signal.SIGSTOP)
    restart_agent(manager)
    manager.wait_active("quiet", but_not=container.pid)
    wait_gone(container.pid)


def test_the_first_status_has_what_an_earlier_agent_left(manager: Manager) -> None:
    manager.deploy("quiet", "calm")
    late = manager.wait_active("quiet").pid
    manager.wait_active("calm")
    os.kill(late, signal.SIGSTOP)
    restart_agent(manager)
    threading.Timer(1.5, os.kill, (late, signal.SIGCONT)).start()
    first = manager.wait_agent()
    assert {each.name for each in first.containers} == {"quiet", "calm"}
    assert len(first.took_over or ()) == 2
    assert not manager.faults(first)


def test_checkpoints_of_another_start_of_the_robot_are_removed(
    manager: Manager,
) -> None:
    """Else what has the same epoch now would go on from them."""
    manager.deploy("quiet")
    (component,) = manager.wait_active("quiet").components
    old = checkpoint_path(manager.folder, component.name, component.epoch)
    old.touch()
    restart_agent(manager)
    manager.wait_adopted("quiet")
    assert old.exists()
    kill_agent(manager)
    (manager.folder / "state").unlink()  # as after a boot
    manager.process = manager.start_agent()
    manager.wait_agent()
    assert not old.exists()


def test_what_ends_in_order_is_not_taken_up_again(manager: Manager) -> None:
    manager.deploy("quiet")
    container = manager.wait_active("quiet")
    manager.process.terminate()
    _, _ = manager.process.communicate(timeout=20)
    assert manager.process.returncode == 0
    wait_gone(container.pid)
    assert not (manager.folder / "state").exists()
    manager.process = manager.start_agent()
    status = manager.wait_agent()
    assert (status.generation, status.took_over) == (0, ())
    assert isinstance(manager.ask(Deployment(generation=1, containers=())), Refused)


def test_what_is_not_known_to_be_wanted_waits_for_the_manager(
    manager: Manager,
) -> None:
    manager.deploy("quiet")
    container = manager.wait_active("quiet")
    kill_agent(manager)
    (manager.folder / "state").write_bytes(b"damaged")
    manager.process = manager.start_agent()
    manager.wait_agent()
    manager.ask(Claim(manager_id("second")), token=9)
    manager.token = 9
    manager.deploy("quiet")
    assert manager.wait_adopted("quiet").pid == container.pid


def test_the_manager_of_before_is_obeyed_and_no_earlier_one(manager: Manager) -> None:
    manager.deploy("quiet")
    manager.wait_active("quiet")
    restart_agent(manager)
    manager.wait_adopted("quiet")
    assert isinstance(manager.ask(Deployment(generation=9, containers=()), 0), Refused)
    manager.deploy("quiet")  # with the token of before


def test_a_second_agent_in_the_folder_is_refused(manager: Manager) -> None:
    second = manager.start_agent()
    _, said = second.communicate(timeout=20)
    assert second.returncode == 2
    assert "another agent uses the folder" in said


def test_containers_end_when_no_agent_comes(
    manager: Manager, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(manager.folder))
    (manager.folder / "sitecustomize.py").write_text(
        "from poise.runtime.container import agent_link\n"
        "agent_link.ORPHAN_LIMIT = 0.5\n"
    )
    restart_agent(manager)
    manager.wait_agent()
    # it may have been killed before it had written down whom it obeyed
    manager.ask(Claim(manager_id("second")), token=9)
    manager.token = 9
    manager.deploy("quiet", "stubborn")
    pids = [manager.wait_active(name).pid for name in ("quiet", "stubborn")]
    os.kill(pids[1], signal.SIGSTOP)  # the zygote kills that one
    pids += children_of(manager.process.pid)
    kill_agent(manager)
    for pid in pids:
        wait_gone(pid)


def test_the_trouble_is_said_when_nothing_can_be_removed_either(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = AgentFolder(tmp_path)
    folder.keep(AgentState(token=1))

    def refuse(*_: object, **__: object) -> NoReturn:
        raise OSError(errno.EROFS, "read-only")

    with monkeypatch.context() as patch:
        patch.setattr(agent_files, "write_private", refuse)
        patch.setattr(Path, "unlink", refuse)
        folder.keep(AgentState(token=2))
    assert "read-only" in folder.trouble
    folder.keep(AgentState(token=2))
    assert not folder.trouble
    assert folder.left().token == 2


def test_what_has_ended_before_it_is_adopted_is_not_adopted(tmp_path: Path) -> None:
    adopted = AdoptedContainers(tmp_path, SystemClock())
    with subprocess.Popen(["true"]) as process:
        pass
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as way:
        way.connect(os.fspath(agent_path(tmp_path)))
        ours = hand_over(way, Orphan(container="nav", pid=process.pid), new_memory())
    assert adopted.next_orphan() is None
    ours.close()
    adopted.close()


@pytest.mark.parametrize("is_memory", [True, False])
def test_what_may_end_under_its_reader_is_not_adopted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, *, is_memory: bool
) -> None:
    adoption = AdoptedContainers(tmp_path, SystemClock())
    path = tmp_path / "page"
    page = os.memfd_create("page") if is_memory else os.open(path, os.O_CREAT)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asking:
        asking.connect(str(agent_path(tmp_path)))
        orphan = Orphan(container="eye", pid=os.getpid())
        hand_over(asking, orphan, page).close()
    assert adoption.next_orphan() is None
    assert "is not a container of this agent" in caplog.text
    os.close(page)
    adoption.close()


def test_one_that_is_too_busy_to_be_asked_is_awaited(tmp_path: Path) -> None:
    paths = [socket_path(tmp_path, name) for name in ("nav", "gone")]
    with ExitStack() as stack:
        for path in paths:
            listening = stack.enter_context(socket.socket(socket.AF_UNIX))
            listening.bind(os.fspath(path))
            listening.listen(0)
            waiting = stack.enter_context(socket.socket(socket.AF_UNIX))
            waiting.connect(os.fspath(path))
        clock = VirtualClock()
        adopted = AdoptedContainers(tmp_path, clock)
        way = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
        assert adopted.awaits("nav")
        way.connect(os.fspath(agent_path(tmp_path)))
        orphan = Orphan(container="nav", pid=os.getpid())
        stack.enter_context(hand_over(way, orphan, new_memory()))
        found = adopted.next_orphan()
        assert found is not None
        found[1].close()
        os.close(found[2])
        assert [adopted.awaits(name) for name in ("nav", "gone")] == [False, True]
        clock.sleep(ADOPT_LIMIT)
        adopted.give_up()
        assert adopted.is_settled()
        adopted.close()


def test_a_state_that_cannot_be_kept_is_not_kept_half(tmp_path: Path) -> None:
    folder = AgentFolder(tmp_path)
    wanted = Deployment(generation=1, containers=())
    folder.keep(AgentState(token=3, wanted=wanted))
    assert folder.left().token == 3
    (tmp_path / "state.new").mkdir()
    folder.keep(AgentState(token=4, wanted=wanted))
    assert "cannot save" in folder.trouble
    assert folder.left() == AgentState()
    (tmp_path / "state.new").rmdir()
    folder.keep(AgentState(token=4, wanted=wanted))
    assert not folder.trouble
    assert folder.left().token == 4
