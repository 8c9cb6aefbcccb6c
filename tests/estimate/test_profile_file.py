import math
from pathlib import Path

import msgspec
import pytest

from poise.errors import RobotError
from poise.estimate import profiles as profile_file
from poise.estimate.profiles import Profile


def test_reads_what_it_wrote(profile: Profile) -> None:
    assert profile_file.from_text(profile_file.to_text(profile), "p.yaml") == profile


def test_keeps_four_digits(profile: Profile) -> None:
    exact = msgspec.structs.replace(profile, agent=0.0123456789)
    read = profile_file.from_text(profile_file.to_text(exact), "p.yaml")
    assert read.agent == 0.01235


@pytest.mark.parametrize(
    "text",
    ["[1, 2]", "robot: [", "robot: r\n", "", "at: 2026-02-30", "seconds: !!int x"],
)
def test_says_which_file_is_no_profile(text: str) -> None:
    with pytest.raises(RobotError, match=r"p\.yaml: not"):
        profile_file.from_text(text, "p.yaml")


def test_says_how_to_replace_what_is_yaml_and_no_profile() -> None:
    says = r"p\.yaml: not a profile: .*`poise`\. Write it again with `poise profile`"
    with pytest.raises(RobotError, match=says):
        profile_file.from_text("robot: r\n", "p.yaml")


@pytest.mark.parametrize("value", [-1.0, math.inf, math.nan])
def test_refuses_what_nothing_measures(profile: Profile, value: float) -> None:
    """Whoever edits a profile by hand reads which number it is."""
    eye = msgspec.structs.replace(profile.components["eye"], memory=value)
    wrong = msgspec.structs.replace(profile, components={"eye": eye})
    says = rf"p\.yaml: not a profile: components\.eye\.memory is {value}, which nothing"
    with pytest.raises(RobotError, match=says):
        profile_file.from_text(profile_file.to_text(wrong), "p.yaml")


def test_says_what_writes_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match="`poise profile` writes it"):
        profile_file.read(tmp_path / "none.yaml")


def test_refuses_costs_of_an_older_kind(profile: Profile) -> None:
    """They did not tell the ends apart; read as nothing, all overheads would be 0."""
    text = profile_file.to_text(msgspec.structs.replace(profile, costs={}))
    older = text.replace("costs: {}", "costs: {remote: {call: 1.0e-3}}")
    with pytest.raises(RobotError, match="unknown field `call`"):
        profile_file.from_text(older, "p.yaml")


def test_a_profile_of_a_newer_poise_is_refused_with_its_version(
    profile: Profile,
) -> None:
    newer = profile_file.to_text(msgspec.structs.replace(profile, poise="99.1.0"))
    with pytest.raises(RobotError, match=r"p\.yaml: it needs Poise 99\.1\.0, and this"):
        profile_file.from_text(f"{newer}later: 1\n", "p.yaml")
