"""`poise simulate`, as a person or a script calls it."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import pytest

from tests.command import Poise
from tests.session.fake_rehearsal import HELLO, FakeRehearsal, rehearsal

pytestmark = pytest.mark.slow
"""Another process reads the robot's code."""

__all__ = ["rehearsal"]


def test_it_prints_the_verdict_and_tables(
    poise: Poise, rehearsal: type[FakeRehearsal]
) -> None:
    done = poise("simulate", HELLO, "--task", "greet", "--for", "10min", "--seed", 5)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("10 min of virtual time: 25 of 2000 deadlines missed")
    assert "auto placement, seed 5" in done.stdout
    (plan,) = rehearsal.plans
    assert (plan.seconds, plan.adapts, plan.tasks) == (600.0, True, ("greet",))


def test_json_is_the_report(poise: Poise, rehearsal: type[FakeRehearsal]) -> None:
    """That it is as the schema says, `run_poise` checks."""
    done = poise("simulate", HELLO, "--placement", "static", "--no-adapt", "--json")
    report = json.loads(done.stdout)
    assert (report["method"], report["seconds"]) == ("static", 60.0)
    assert report["loads"][1]["capacity"] is None
    assert not rehearsal.plans[0].adapts


def test_placements_are_compared(
    poise: Poise, rehearsal: type[FakeRehearsal], tmp_path: Path
) -> None:
    rehearsal.fails = "greedy"
    words = ("simulate", HELLO, "--compare", "auto, static,greedy", "--json")
    done = poise(*words, "--html", "page.html")
    found = json.loads(done.stdout)
    assert list(found["results"]) == ["auto", "static"]
    assert found["without"] == {"greedy": "'printer' did not come up"}
    assert done.returncode == 1
    assert "simulating static placement" in done.stderr
    assert "wrote page.html" in done.stderr
    assert "<h1>static</h1>" in (tmp_path / "page.html").read_text()


@pytest.mark.usefixtures("rehearsal")
def test_an_outcome_is_printed_though_its_page_cannot_be_written(poise: Poise) -> None:
    done = poise("simulate", HELLO, "--html", "/dev/full", "--json")
    assert json.loads(done.stdout)["seconds"] == 60.0
    assert done.returncode == 1
    assert "/dev/full cannot be written: No space left on device" in done.stderr


def test_faults_come_from_a_file(
    poise: Poise, rehearsal: type[FakeRehearsal], tmp_path: Path
) -> None:
    text = "faults: [{at: 5 s, fault: kill agent, computer: left, for: 2 s}]"
    (tmp_path / "faults.yaml").write_text(text)
    done = poise("simulate", HELLO, "--faults", "faults.yaml")
    assert done.returncode == 0, done.stderr
    assert [str(fault) for fault in rehearsal.plans[0].faults] == [
        "5.00 s: kill agent left for 2.00 s"
    ]


def test_a_wrong_file_simulates_nothing(
    poise: Poise, rehearsal: type[FakeRehearsal], tmp_path: Path
) -> None:
    text = "faults: [{at: 5 s, fault: kill agent, computer: lfet, for: 2 s}]"
    (tmp_path / "faults.yaml").write_text(text)
    done = poise("simulate", HELLO, "--faults", "faults.yaml", "--json")
    assert done.returncode == 1
    (problem,) = json.loads(done.stdout)["problems"]
    assert (problem["line"], problem["column"]) == (1, 1 + text.index("computer"))
    assert rehearsal.plans == []


def test_a_violated_promise_is_exit_code_1(
    poise: Poise, rehearsal: type[FakeRehearsal]
) -> None:
    rehearsal.violations = ("committed-stays: printer",)
    done = poise("simulate", HELLO)
    assert done.returncode == 1
    assert done.stdout.startswith("a defect of Poise: 1 promise did not hold")


def test_a_robot_that_does_not_come_up_is_exit_code_1(
    poise: Poise, rehearsal: type[FakeRehearsal]
) -> None:
    rehearsal.fails = "auto"
    done = poise("simulate", HELLO)
    assert done.returncode == 1
    assert "'printer' did not come up" in done.stderr


def test_ctrl_c_prints_what_is_known_so_far(
    poise: Poise, rehearsal: type[FakeRehearsal], monkeypatch: pytest.MonkeyPatch
) -> None:
    advance = FakeRehearsal.advance

    def interrupted(self: FakeRehearsal, seconds: float) -> None:
        advance(self, seconds)
        if self.now == 10.0:
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(rehearsal, "advance", interrupted)
    done = poise("simulate", HELLO, "--for", "1h")
    assert done.returncode == 130
    assert done.stdout.startswith(
        "10 s of 1 h of virtual time, then it was ended early"
    )


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--for", "0s"), "--for 0s: a simulation must last longer than 0 s"),
        (("--for", "1 hour"), "unknown unit 'hour'"),
        (("--placement", "best"), "no method 'best'"),
        (("--placement", "auto", "--compare", "static"), "--compare static and"),
        (("--task", "gret"), "'gret'"),
        (("--html", "no-such-folder/page.html"), "cannot be written"),
    ],
)
def test_wrong_use_simulates_nothing(
    words: tuple[str, ...], says: str, poise: Poise, rehearsal: type[FakeRehearsal]
) -> None:
    done = poise("simulate", HELLO, *words)
    assert done.returncode == 2
    assert says in done.stderr
    assert rehearsal.plans == []
