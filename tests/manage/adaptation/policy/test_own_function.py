"""A policy's own function decides, and can hold up nothing."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from poise.manage.adaptation.policies import OwnFunction, Policies
from poise.model.policy import ComputerValues, Policy, PolicyAction, Seen

pytestmark = pytest.mark.slow

CODE = """
import time
from poise import PolicyAction

def careful(seen):
    return [
        PolicyAction(do="notify", about=c.name, why=f"{c.name} is busy")
        for c in seen.computers
        if c.used > 0.5
    ]

def broken(seen):
    raise ValueError("no idea")

def odd(seen):
    return ["restart"]

def stranger(seen):
    return [PolicyAction(do="restart", about="nobody", why="so")]

def thorough(seen):
    actions = "notify", "replan", "suspend"
    return [PolicyAction(do=do, about="left", why=do) for do in actions]

def hangs(seen):
    while True:
        pass

def talks(seen):
    print("I look", flush=True)


def quiet(seen):
    pass

def lone(seen):
    return "notify"

def explodes(seen):
    return [PolicyAction(do="explode", about="left", why="so")]

def aimless(seen):
    return [PolicyAction(do="move", about="eyes", why="so")]

def leaves(seen):
    import os
    os._exit(3)
"""
SEEN = Seen(at=0.0, computers=(ComputerValues(name="left", used=0.9),))


@pytest.fixture
def function(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[OwnFunction]:
    (tmp_path / "mine.py").write_text(CODE, encoding="utf-8")
    made = OwnFunction(f"mine:{request.param}", str(tmp_path))
    yield made
    made.close()


@pytest.mark.parametrize("function", ["careful"], indirect=True)
def test_what_is_seen_of_a_large_robot_holds_nothing_up(
    function: OwnFunction,
) -> None:
    """It is more than a socket holds, and the function is imported meanwhile."""
    names = (f"computer-{k}" for k in range(40_000))
    many = tuple(ComputerValues(name=name, used=0.1) for name in names)
    seen = Seen(at=0.0, computers=(*many, *SEEN.computers))
    assert function.ask(seen) == ()
    assert not function.trouble
    assert function._writer.is_waiting
    (action,) = function.ask(msgspec.structs.replace(seen, at=0.1), waits=True)
    assert (action.about, function.trouble) == ("left", "")


@pytest.mark.parametrize("function", ["careful"], indirect=True)
def test_it_sees_the_values_and_says_what_to_do(function: OwnFunction) -> None:
    action = PolicyAction(do="notify", about="left", why="left is busy")
    assert function.ask(SEEN, waits=True) == (action,)
    assert function.ask(Seen(at=1.0), waits=True) == ()
    assert not function.trouble


@pytest.mark.parametrize("function", ["talks"], indirect=True)
def test_what_it_prints_is_no_output_of_a_command(
    function: OwnFunction, capfd: pytest.CaptureFixture[str]
) -> None:
    """It was in the midst of what `--json` prints."""
    assert function.ask(SEEN, waits=True) == ()
    function.close()
    assert capfd.readouterr() == ("", "I look\n")


@pytest.mark.parametrize("function", ["careful"], indirect=True)
def test_the_manager_does_not_wait_for_it(function: OwnFunction) -> None:
    assert function.ask(SEEN) == ()  # its process only begins


@pytest.mark.parametrize("function", ["broken"], indirect=True)
def test_its_error_is_said_and_it_is_asked_again(function: OwnFunction) -> None:
    assert function.ask(SEEN, waits=True) == ()
    assert function.trouble.endswith("ValueError: no idea\n")
    process = function._process
    function.ask(SEEN, waits=True)
    assert function._process is process


@pytest.mark.parametrize(
    ("function", "said"),
    [
        ("odd", "failed: it returned 'restart', not a PolicyAction"),
        ("lone", "failed: it returned 'notify', not a list"),
        ("explodes", "Invalid enum value 'explode' - at `$.do`"),
        ("aimless", "it moves 'eyes': there is no computer ''; computers: 'left'"),
        ("leaves", "ended its process with exit code 3; it is asked again in 10 s"),
    ],
    indirect=["function"],
)
def test_what_is_no_action_is_said(function: OwnFunction, said: str) -> None:
    assert function.ask(SEEN, waits=True) == ()
    assert function.trouble.endswith(said)


@pytest.mark.parametrize("function", ["missing"], indirect=True)
def test_a_function_that_there_is_not_is_said(function: OwnFunction) -> None:
    function.ask(SEEN, waits=True)
    assert "has no attribute 'missing'" in function.trouble


@pytest.mark.parametrize("function", ["quiet"], indirect=True)
def test_it_may_return_nothing(function: OwnFunction) -> None:
    assert function.ask(SEEN, waits=True) == ()
    assert not function.trouble


@pytest.mark.parametrize("function", ["hangs"], indirect=True)
def test_one_that_hangs_is_ended_and_started_again_later(function: OwnFunction) -> None:
    function.ask(SEEN, waits=True)
    assert function.trouble == (
        "'mine:hangs' took too long and was ended: its limit is 1 s, and 20 s for its "
        "import; it is asked again in 10 s"
    )
    assert function._process is None
    function.ask(Seen(at=9.0))
    assert function._process is None
    function.ask(Seen(at=10.0))
    assert function._process is not None


def test_an_action_about_nobody_is_said(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(CODE, encoding="utf-8")
    policies = Policies([Policy(name="own", call="mine:stranger")], str(tmp_path))
    try:
        assert policies.evaluate(SEEN.of, 0.0, waits=True) == ()
        assert policies.troubles()["own"] == (
            "policy 'own': 'mine:stranger' names no subject 'nobody' for 'restart'"
        )
    finally:
        policies.close()


def test_an_action_about_what_does_not_run_now_is_no_mistake(tmp_path: Path) -> None:
    """Such as one that suspends what is suspended already."""
    (tmp_path / "mine.py").write_text(CODE, encoding="utf-8")
    own = Policy(name="own", call="mine:stranger")
    policies = Policies([own], str(tmp_path), ["nobody"])
    try:
        assert policies.evaluate(SEEN.of, 0.0, waits=True) == ()
        assert policies.troubles() == {}
    finally:
        policies.close()


def test_what_is_to_be_suspended_is_known_while_it_does_not_run(
    tmp_path: Path,
) -> None:
    code = CODE.replace('do="restart", about="nobody"', 'do="suspend", about="eyes.t"')
    (tmp_path / "mine.py").write_text(code, encoding="utf-8")
    own = Policy(name="own", call="mine:stranger")
    policies = Policies([own], str(tmp_path), ["eyes"])
    try:
        assert policies.evaluate(SEEN.of, 0.0, waits=True) == ()
        assert policies.suspends == {"eyes"}
    finally:
        policies.close()


def test_an_action_for_a_container_about_a_component_is_said(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        CODE.replace('do="restart", about', 'do="restart elsewhere", about'),
        encoding="utf-8",
    )
    own = Policy(name="own", call="mine:stranger")
    policies = Policies([own], str(tmp_path), ["nobody"])
    try:
        assert policies.evaluate(SEEN.of, 0.0, waits=True) == ()
        assert "names no subject 'nobody'" in policies.troubles()["own"]
    finally:
        policies.close()


def test_several_things_may_be_done_about_one_subject(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(CODE, encoding="utf-8")
    own = Policy(name="own", call="mine:thorough", lasts=0.0)
    policies = Policies([own], str(tmp_path))
    try:
        found = policies.evaluate(SEEN.of, 0.0, waits=True)
        assert [each.what for each in found] == ["notify", "replan", "suspend"]
        policies.note_acted(found[:2], 0.0)
        assert policies.due(found, 1.0) == found[2:]  # it has not been done
    finally:
        policies.close()
