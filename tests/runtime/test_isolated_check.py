"""Code that ends, crashes or hangs as it is imported is a problem like others."""

from __future__ import annotations

import os
import resource
import select
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from poise.model.loading import load_source
from poise.model.robot import (
    Architecture,
    ComponentEntry,
    Connector,
    ConnectorEnd,
    Robot,
)
from poise.model.software import CodeTimer
from poise.runtime.code_check import check_code_isolated
from tests.waiting import LONG

pytestmark = pytest.mark.slow

SHORT = 5.0
"""For what hangs [s]; far longer than anything else takes."""
MANY = 1100
"""More files than `select` takes."""
GOOD = "from poise import Component\nclass Good(Component): pass\n"

Check = Callable[..., list[str]]


@pytest.fixture
def check(tmp_path: Path) -> Check:
    """Return a function that checks a robot whose module `bad` has this code."""

    def checked(code: str, *names: str, limit: float = LONG) -> list[str]:
        (tmp_path / "bad.py").write_text(GOOD + code)
        (tmp_path / "good.py").write_text(GOOD)
        parts = (
            *(
                ComponentEntry(name=n, implementation="bad:Good")
                for n in names or ("a",)
            ),
            ComponentEntry(name="good", implementation="good:Good"),
            ComponentEntry(name="absent", implementation="good:Absent"),
        )
        robot = Robot(
            name="r",
            folder=str(tmp_path),
            architectures=(Architecture(name="x", function="f", components=parts),),
        )
        return [f.message for f in check_code_isolated(robot, limit).findings]

    return checked


def has_ended(pid: int) -> bool:
    """Wait until a process has ended, for a while."""
    try:
        process = os.pidfd_open(pid)
    except ProcessLookupError:
        return True
    with os.fdopen(process):
        return select.select([process], [], [], 10.0) != ([], [], [])


@pytest.mark.parametrize(
    ("code", "how"),
    [
        ("import os; os._exit(0)", "ended the process with exit code 0"),
        ("import os; os._exit(7)", "ended the process with exit code 7"),
        ("import os; os.abort()", "crashed by signal 6 (SIGABRT)"),
        ("import ctypes; ctypes.string_at(0)", "crashed by signal 11 (SIGSEGV)"),
        ("import os; os.kill(os.getpid(), 35)", "crashed by signal 35 (signal 35)"),
        ("import time; time.sleep(600)", "did not end within 5 s"),
    ],
)
def test_names_the_module_and_checks_the_others(
    check: Check, code: str, how: str
) -> None:
    fatal, other = check(code, limit=SHORT if "within" in how else LONG)
    assert fatal.startswith(f"component 'a': the import of module 'bad' {how}. ")
    assert "has no class 'Absent'" in other


def test_a_module_of_two_components_is_one_problem(check: Check) -> None:
    fatal, other = check("import os; os._exit(1)", "a", "b")
    assert "component 'a'" in fatal
    assert "Absent" in other


def test_a_program_with_many_open_files_may_check(check: Check) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard < MANY + 100:
        pytest.skip("this user may not open so many files")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, MANY + 100), hard))
    files = [os.open(os.devnull, os.O_RDONLY) for _ in range(MANY)]
    try:
        (other,) = check("")
    finally:
        for file in files:
            os.close(file)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert "Absent" in other


def test_what_the_code_prints_goes_to_stderr(
    check: Check, capfd: pytest.CaptureFixture[str]
) -> None:
    (other,) = check("print('hello'); import sys; sys.stdin.read()")
    assert "Absent" in other
    assert capfd.readouterr() == ("", "hello\n")


def test_processes_that_the_code_starts_end_with_the_check(
    check: Check, tmp_path: Path
) -> None:
    started = tmp_path / "started"
    check(
        "import os, time\n"
        "if not (pid := os.fork()): time.sleep(600)\n"
        f"open({str(started)!r}, 'w').write(str(pid))\n"
    )
    assert has_ended(int(started.read_text()))


def test_an_import_that_fails_is_one_problem_for_all_who_need_it(check: Check) -> None:
    absent, one = sorted(check("import no_such_module\n", "a", "b", "c"))
    assert "good:Absent" in absent
    assert "no_such_module" in one
    assert "(component 'a', and for the same reason 'b', 'c')\n" in one


def test_modules_that_share_a_broken_one_have_one_problem(tmp_path: Path) -> None:
    (tmp_path / "shared.py").write_text("1 / 0\n")
    (tmp_path / "other.py").write_text("import shared\n")
    robot = Robot(
        name="r",
        folder=str(tmp_path),
        architectures=(
            Architecture(
                name="x",
                function="f",
                components=tuple(
                    ComponentEntry(name=n, implementation=f"{n}:Any")
                    for n in ("shared", "other")
                ),
            ),
        ),
    )
    (finding,) = check_code_isolated(robot).findings
    assert "ZeroDivisionError" in finding.message
    assert "and for the same reason 'other'" in finding.message


def test_other_work_goes_on_while_code_is_imported(tmp_path: Path) -> None:
    begun = tmp_path / "begun"
    (tmp_path / "patient.py").write_text(
        "import pathlib, time\n"
        f"while not pathlib.Path({str(begun)!r}).exists():\n    time.sleep(0.01)\n"
        f"{GOOD}"
    )
    component = ComponentEntry(name="a", implementation="patient:Good")
    robot = Robot(
        name="r",
        folder=str(tmp_path),
        architectures=(Architecture(name="x", function="f", components=(component,)),),
    )
    assert check_code_isolated(robot, meanwhile=begun.touch).findings == []


def test_what_classes_declare_is_known_without_importing_them_here(
    tmp_path: Path,
) -> None:
    (tmp_path / "declares.py").write_text(
        "import poise\n"
        "class Ticks(poise.Component):\n"
        "    out: poise.Published[int]\n"
        "    @poise.every(0.2, deadline=0.1)\n"
        "    def tick(self) -> None: ...\n"
        "    @poise.subscribed(keep=3)\n"
        "    def seen(self, number: int) -> None: self._hand_on(number)\n"
        "    def _hand_on(self, number: int) -> None:\n"
        "        list(map(lambda each: self.out.publish(each), [number]))\n"
    )
    components = tuple(
        ComponentEntry(name=name, implementation="declares:Ticks") for name in "ab"
    )
    robot = Robot(
        name="r",
        folder=str(tmp_path),
        architectures=(Architecture(name="x", function="f", components=components),),
        connectors=tuple(
            Connector(
                between=(ConnectorEnd(source, "out"), ConnectorEnd(target, "seen"))
            )
            for source, target in ("ab", "ba")
        ),
    )
    code = check_code_isolated(robot).code["a"]
    assert code.timers == (CodeTimer("tick", 0.2, 0.1),)
    assert code.keep == {"seen": 3}
    assert code.sends == {"tick": (), "seen": ("out",)}
    assert "declares" not in sys.modules


def test_a_module_that_loads_its_own_robot_is_told_to_guard_that(
    tmp_path: Path,
) -> None:
    """Else each check would import it, and so begin another one."""
    file = tmp_path / "robot.yaml"
    (tmp_path / "bad.py").write_text(f"{GOOD}import poise\npoise.load({str(file)!r})\n")
    file.write_text("""
robot: own
computers: {a: {cpu: 1, memory: 1 GiB}}
architectures: {x: {function: f, components: {a: {implementation: 'bad:Good'}}}}
""")
    (finding,) = check_code_isolated(load_source(file).robot, SHORT).findings
    assert "UsageError: a robot is loaded while its code is imported" in finding.message
