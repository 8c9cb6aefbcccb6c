"""A chain that no placement keeps is a problem of the robot file."""

from pathlib import Path

import pytest

from poise.model import load
from poise.session.robot_file import check, check_late_chains

FILE = """
robot: hunter
computers: {{nose: {{cpu: {cpu}, memory: 1 GiB}}, back: {{cpu: 1, memory: 1 GiB}}}}
devices: {{lidar: {{computer: nose}}, wheels: {{computer: nose}}}}
links: [{{between: [nose, back], {link}}}]
architectures:
  hunt:
    function: hunting
    components:
      scan: {{cpu: 10%, devices: [lidar]}}
      match: {{cpu: 30%{where}}}
      drive: {{cpu: 10%, devices: [wheels]}}
    connectors:
      - {{between: [scan, match], message: {message}, rate: 5 Hz}}
      - {{between: [match, drive], message: 100 B, rate: 5 Hz}}
chains: {{hunt: {{through: [scan, match, drive], deadline: 50 ms}}}}
"""
ROOM = {"cpu": "1", "link": "latency: 30 ms", "where": "", "message": "1 kB"}


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        # once round the link is enough time, twice is not
        ({}, ()),
        ({"link": "latency: 20 ms", "where": ", only: [back]"}, ()),
        ({"where": ", only: [back]"}, ("takes 60 ms, limit 50 ms", "(only back)")),
        ({"cpu": "40%"}, ("nose has 0.4 cpu", "0.1 more cpu on nose")),
        # 100 kB over 1 MB/s take 100 ms
        (
            {
                "link": "bandwidth: 8 Mbit/s",
                "where": ", only: [back]",
                "message": "100 kB",
            },
            ("takes 100 ms", "scan to match"),
        ),
    ],
    ids=["beside", "once", "pinned", "full", "slow"],
)
def test_a_chain_that_links_make_late_wherever_it_runs(
    tmp_path: Path, keys: dict[str, str], words: tuple[str, ...]
) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(FILE.format(**(ROOM | keys)), encoding="utf-8")
    found = [*check_late_chains(load(file))]
    assert len(found) == bool(words)
    for finding in found:
        assert finding.path == ("chains", "hunt", "deadline")
        assert "chain 'hunt' cannot meet its deadline of 50 ms" in finding.message
        assert all(word in finding.message for word in words), finding.message


def test_what_fits_nowhere_is_no_problem_of_the_chain(tmp_path: Path) -> None:
    """The lidar and the wheels are on a computer with room for one of their users."""
    file = tmp_path / "robot.yaml"
    file.write_text(FILE.format(**(ROOM | {"cpu": "15%"})), encoding="utf-8")
    assert [*check_late_chains(load(file))] == []


@pytest.mark.slow
def test_check_says_it_with_its_line(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(FILE.format(**(ROOM | {"cpu": "40%"})), encoding="utf-8")
    (problem,) = check(file)
    assert (problem.line, "cannot meet" in problem.message) == (16, True)
