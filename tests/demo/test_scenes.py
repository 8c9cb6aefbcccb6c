"""The scenes of the demo show what they say."""

from __future__ import annotations

import json
from typing import Any

import pytest

from poise.emulate import probe_host
from tests.command import run_poise


@pytest.mark.exhaustive
@pytest.mark.slow
def test_components_of_a_crashed_computer_go_on_elsewhere() -> None:
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))
    done = run_poise("demo", "--scene", "lost-computer", "--json")
    assert done.returncode == 0, done.stderr
    scene = json.loads(done.stdout)
    assert scene["scene"] == "lost-computer"
    assert scene["ok"]
    assert 0 < scene["detected_s"] <= scene["active_s"]
    assert "'left' loses power" in done.stderr


@pytest.mark.slow
@pytest.mark.exhaustive
def test_another_computer_leads_when_that_of_the_manager_dies() -> None:
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))
    done = run_poise("demo", "--scene", "lost-leader", "--json")
    assert done.returncode == 0, done.stderr
    scene = json.loads(done.stdout)
    assert scene["ok"]
    assert 0 < scene["detected_s"] <= scene["active_s"]
    assert scene["leader_s"] > 0
    assert not scene["active_twice"]
    assert not scene["tasks_lost"]


@pytest.mark.slow
@pytest.mark.exhaustive
def test_a_robot_outlives_its_manager_amid_a_move() -> None:
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))
    done = run_poise("demo", "--scene", "manager-killed", "--json")
    assert done.returncode == 0, done.stderr
    scene = json.loads(done.stdout)
    assert scene["ok"]
    assert scene["back_s"] > 0
    wrong = ("moved", "active_twice", "lost", "doubled", "reordered")
    assert not any(scene[name] for name in wrong)
    assert "'passer' from 'left' to 'right' was interrupted" in done.stderr


@pytest.mark.slow
@pytest.mark.exhaustive
def test_what_was_cut_off_is_active_elsewhere_and_never_twice() -> None:
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))
    done = run_poise("demo", "--scene", "cut-link", "--json")
    assert done.returncode == 0, done.stderr
    scene = json.loads(done.stdout)
    assert scene["ok"]
    assert 0 < scene["detected_s"] <= scene["active_s"]
    assert not any(scene[name] for name in ("active_twice", "doubled", "reordered"))
    assert scene["lost"] > 0


@pytest.mark.slow
@pytest.mark.exhaustive
def test_the_middle_of_a_chain_leaves_a_link_that_is_cut() -> None:
    scene = played("cut-one-link")
    assert scene["active_twice"] == scene["doubled"] == scene["reordered"] == 0
    assert scene["moved_s"] is not None  # while the link was cut
    assert scene["lost"] > 0
    assert scene["ok"]


@pytest.mark.slow
@pytest.mark.exhaustive
def test_nothing_is_active_twice_while_an_agent_is_stopped() -> None:
    scene = played("frozen-agent")
    assert scene["active_twice"] == scene["beside_s"] == 0
    assert scene["moved_s"] is not None
    assert scene["ok"]


def played(scene: str) -> dict[str, Any]:
    """Return what a scene on three computers reported, whether or not it went well."""
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))
    done = run_poise("demo", "--scene", scene, "--json")
    assert done.stdout.startswith('{"scene"'), done.stderr
    return dict(json.loads(done.stdout))


@pytest.mark.slow
@pytest.mark.exhaustive
def test_three_tasks_share_functions_and_one_pauses_another() -> None:
    done = run_poise("demo", "--scene", "tasks", "--json")
    assert done.returncode == 0, done.stderr
    scene = json.loads(done.stdout)
    names = {each["name"]: each["outcome"] for each in scene["tasks"]}
    assert names == dict.fromkeys(("fetch", "watch", "wave"), "done")
    assert scene["switch_hit_s"] > 0
    assert scene["switch_miss_s"] > 0
    assert "task 'fetch' waits: task 'wave' uses the device 'arm'" in done.stderr
