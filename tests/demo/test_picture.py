from __future__ import annotations

from xml.etree import ElementTree as ET

from examples.demo.picture import DrivePicture, drives_picture

SVG = "{http://www.w3.org/2000/svg}"


def drive(title: str, *, is_good: bool) -> DrivePicture:
    return DrivePicture(
        title=title,
        verdict="goal reached in 3 s" if is_good else "goal missed by 2.0 m",
        is_good=is_good,
        world={
            "path": [(0.0, 1.0), (2.0, 1.0)],
            "walls": [(0, 0, 2, 0)],
            "goal": (2.0, 1.0),
            "functions": {"navigation": is_good},
        },
        cpu={"main": 0.5},
        placement={"localiser": "main", "face_animator": "main"},
        late=0.25,
    )


def test_draws_two_drives_side_by_side_in_different_colours() -> None:
    """A wall 2 m long and a path 1 m above it: 440 pixels wide, 220 a metre."""
    drives = [drive("a < b", is_good=False), drive("c", is_good=True)]
    root = ET.fromstring(drives_picture(drives))
    assert root.get("width") == "968"  # 2 x 24 + 2 x 440 + 40
    panels = root.findall(f"{SVG}g")
    assert [each.get("transform") for each in panels] == [
        "translate(24,0)",
        "translate(504,0)",
    ]
    lines = [panel.findall(f"{SVG}polyline") for panel in panels]
    assert [each.get("points") for each in lines[0]] == [
        "0.0,324.0 440.0,324.0",
        "0.0,104.0 440.0,104.0",
    ]
    colours = [panel[1].get("stroke") for panel in lines]
    assert colours == ["#c62828", "#2e7d32"]
    words = [text.text for text in panels[0].iter(f"{SVG}text")]
    assert words == [
        "a < b",
        "✗ goal missed by 2.0 m",
        "the pose was too old at 25% of the navigator's checks",
        "goal",
        "main: 50% of its CPU",
        "a component of the navigator",
        "✗ navigation",
    ]


def test_draws_a_drive_of_which_the_world_said_nothing() -> None:
    silent = DrivePicture(
        title="Poise",
        verdict="goal not reached",
        is_good=False,
        world={},
        cpu={},
        placement={},
        late=1.0,
    )
    assert ET.fromstring(drives_picture([silent])).findall(f"{SVG}g")
