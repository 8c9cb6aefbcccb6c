from __future__ import annotations

from xml.etree import ElementTree as ET

from examples.demo.picture import DrivePicture, drives_picture

SVG = "{http://www.w3.org/2000/svg}"


def test_draws_walls_paths_and_bars() -> None:
    """A wall 2 m long and a path above it; y grows upwards, 55 pixels a metre."""
    drive = DrivePicture(
        title="a < b",
        path=[(0.0, 1.0), (2.0, 1.0)],
        shares={"missed": 0.5},
        verdict="late",
    )
    picture = drives_picture([drive], walls=[(0, 0, 2, 0)], goal=[(2.0, 1.0)])
    root = ET.fromstring(picture)
    wall, path = (line.get("points") for line in root.iter(f"{SVG}polyline"))
    assert wall == "30.0,105.0 140.0,105.0"
    assert path == "30.0,50.0 140.0,50.0"
    texts = [text.text for text in root.iter(f"{SVG}text")]
    assert texts == ["a < b", "missed: 50%", "late"]
    assert [bar.get("width") for bar in root.iter(f"{SVG}rect")] == ["100%", "115.0"]
