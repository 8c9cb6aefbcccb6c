"""Diagrams of small robots, in each notation."""

from __future__ import annotations

from itertools import combinations, pairwise
from pathlib import Path
from typing import cast
from xml.etree import ElementTree as ET

import pytest

from poise.errors import RobotError, UsageError
from poise.model.robot import (
    Architecture,
    ComponentEntry,
    Computer,
    Connector,
    ConnectorEnd,
    DeclaredPort,
    Device,
    Link,
    Robot,
)
from poise.session.diagrams.diagram import BoxDiagram, Join, SequenceDiagram
from poise.session.diagrams.draw import FORMATS, Drawing, What, draw

GIB = 2**30


def port(name: str, kind: str, type_: str) -> DeclaredPort:
    return DeclaredPort(name=name, kind=kind, type=type_)  # type: ignore[arg-type]


def joined(source: str, target: str, **more: float) -> Connector:
    ends = [ConnectorEnd(*end.split(".")) for end in (source, target)]
    return Connector(between=(ends[0], ends[1]), **more)  # type: ignore[arg-type]


def component(name: str, *ports: DeclaredPort, cpu: float = 0.25) -> ComponentEntry:
    demand = {"cpu": cpu, "memory": GIB / 4}
    return ComponentEntry(name=name, demand=demand, ports=ports, state=2048.0)


SEES = Architecture(
    name="sees",
    function="seeing",
    home="left",
    components=(
        component("eye", port("image", "publishes", "m:Image")),
        component("mind", port("ask", "requires", "m:Maps")),
    ),
    connectors=(joined("eye.image", "mind.image", message=1000, rate=10),),
)
KNOWS = Architecture(
    name="knows",
    function="knowing",
    home="left",
    components=(component("map", port("maps", "provides", "m:Maps")),),
)
ROBOT = Robot(
    name="small",
    computers=tuple(
        Computer(name=name, capacity={"cpu": 1.0, "memory": GIB})
        for name in ("left", "right")
    ),
    links=(Link(between=("left", "right"), bandwidth=12.5e6),),
    devices=(Device(name="camera", computer="left"),),
    architectures=(SEES, KNOWS),
    connectors=(joined("mind.ask", "map.maps"), joined("map", "eye")),
)
NOW = {"eye": "left", "mind": "left", "map": "left"}
THEN = {"eye": "left", "mind": "right", "map": "left"}
PLACEMENTS = {"now": NOW, "then": THEN}
ALL: tuple[Drawing, ...] = (
    draw(ROBOT),
    draw(ROBOT, "deployment", PLACEMENTS),
    draw(ROBOT, "transition", PLACEMENTS),
)


def test_components_are_joined_by_flows_calls_and_what_is_not_known() -> None:
    diagram = draw(ROBOT).diagram
    assert isinstance(diagram, BoxDiagram)
    assert diagram.joins == (
        Join("eye", "mind", "flow", "image", ("Image",)),
        Join("mind", "map", "call", "maps", ("Maps",)),
        Join("map", "eye", "use"),
    )
    assert [each.name for each in diagram.boxes] == ["sees", "knows"]


def test_a_placement_shows_loads_and_what_goes_between_computers() -> None:
    diagram = draw(ROBOT, "deployment", PLACEMENTS).diagram
    assert isinstance(diagram, BoxDiagram)
    assert [box.name for box in diagram.boxes] == ["now", "then"]
    before, after = diagram.joins
    left, right = diagram.boxes[1].boxes
    # two of three components, a quarter each
    assert left.lines == (
        "cpu: 50% of 1 core",
        "memory: 50% of 1 GiB",
        "devices: camera",
    )
    assert [(part.name, part.remark) for part in right.boxes] == [("mind", "from left")]
    assert before.lines == ("12.5 MB/s",)
    assert after.lines == (
        "12.5 MB/s",
        "2 connectors, 9.77 KiB/s",  # 1,000 B at 10 Hz
        "eye → mind",
        "mind → map",
    )


def test_a_transition_tells_who_does_what_in_order() -> None:
    diagram = draw(ROBOT, "transition", PLACEMENTS).diagram
    assert isinstance(diagram, SequenceDiagram)
    assert diagram.lifelines == ("manager", "left", "right")
    assert [(m.source, m.target, m.text) for m in diagram.messages] == [
        ("manager", "right", "prepare mind"),
        ("manager", "left", "pause mind"),
        ("left", "right", "state of mind, 2 KiB"),
        ("manager", "right", "resume mind"),
        ("manager", "left", "end mind"),
    ]


def test_a_transition_that_does_not_fit_says_why() -> None:
    heavy = ROBOT.with_components(
        lambda c: component(c.name, cpu=0.9) if c.name == "mind" else c
    )
    with pytest.raises(RobotError, match="'left' would be overfull"):
        draw(heavy, "transition", {"then": THEN, "now": NOW})


def test_placements_ask_for_a_deployment_diagram() -> None:
    assert draw(ROBOT, placements=PLACEMENTS) == draw(ROBOT, "deployment", PLACEMENTS)


def test_what_is_missing_is_said() -> None:
    with pytest.raises(UsageError, match="transition got 1"):
        draw(ROBOT, "transition", {"now": NOW})
    with pytest.raises(UsageError, match="components got 1"):
        draw(ROBOT, "components", {"now": NOW})
    with pytest.raises(UsageError, match="no diagram 'boxes'"):
        draw(ROBOT, cast("What", "boxes"))
    with pytest.raises(UsageError, match=r"no task 'dance' \(its tasks: "):
        draw(ROBOT, task="dance")
    with pytest.raises(UsageError, match=r"robot\.gif: .*\.svg"):
        draw(ROBOT).save("robot.gif")


@pytest.mark.parametrize("place", [("gone", "left"), ("eye", "nowhere")])
def test_what_runs_and_is_in_no_file_is_named(place: tuple[str, str]) -> None:
    """So it is when the file was changed since the robot was started."""
    running, auto = dict([place]), {"eye": "left"}
    with pytest.raises(UsageError, match=f"'{place[0]}' on '{place[1]}': the"):
        draw(ROBOT, "deployment", {"running": running})
    with pytest.raises(UsageError, match="placement 'running' has"):
        draw(ROBOT, "transition", {"running": running, "auto": auto})


@pytest.mark.parametrize("drawing", ALL)
@pytest.mark.parametrize("ending", FORMATS)
def test_every_notation_names_everything(drawing: Drawing, ending: str) -> None:
    text = drawing.text(ending)
    assert "mind" in text
    assert "small" in text
    is_sequence = isinstance(drawing.diagram, SequenceDiagram)
    for name in ("right",) if is_sequence else ("eye", "map"):
        assert name in text


def test_mermaid_reads_as_its_documentation_has_it() -> None:
    lines = draw(ROBOT).text(".mmd").splitlines()
    assert lines[:4] == ["---", 'title: "small"', "---", "flowchart LR"]
    frame = '  subgraph n_frame_sees["«subsystem»<br/>sees<br/>provides seeing"]'
    assert frame in lines
    assert '  n_eye -.->|"«flow» Image"| n_mind' in lines


def test_plantuml_has_a_ball_and_a_socket() -> None:
    lines = draw(ROBOT).text(".puml").splitlines()
    assert 'interface "Maps" as n_ball_map_maps' in lines
    assert "n_ball_map_maps - n_map" in lines
    assert "n_mind -( n_ball_map_maps" in lines


def test_names_with_signs_of_the_notation_stay_text() -> None:
    odd = ROBOT.with_components(lambda c: component("a<b>&c") if c.name == "eye" else c)
    assert "a&lt;b&gt;&amp;c" in draw(odd).text(".svg")


def large() -> Robot:
    """Return a robot of 60 components on 4 computers."""
    parts = []
    for i in range(12):
        names = [f"part_{i}_{j}" for j in range(5)]
        ends = [
            port("out", "publishes", f"m:Data{i}"),
            port("api", "provides", "m:Api"),
        ]
        parts.append(
            Architecture(
                name=f"architecture_{i}",
                function=f"function_{i}",
                components=tuple(component(name, *ends) for name in names),
                connectors=tuple(
                    joined(f"{one}.out", f"{two}.in")
                    if j % 2
                    else joined(f"{one}.need", f"{two}.api")
                    for j, (one, two) in enumerate(pairwise(names))
                ),
            )
        )
    computers = tuple(
        Computer(name=f"c{i}", capacity={"cpu": 8.0, "memory": 8 * GIB})
        for i in range(4)
    )
    return Robot(
        name="large",
        computers=computers,
        links=(Link(between=("c0", "c3"), bandwidth=12.5e6),),
        architectures=tuple(parts),
        connectors=tuple(
            joined(f"part_{i}_4.out", f"part_{i + 1}_0.in") for i in range(11)
        ),
    )


def test_a_picture_is_written(tmp_path: Path) -> None:
    path = tmp_path / "robot.svg"
    draw(ROBOT).save(path)
    assert path.read_text().startswith("<svg")


def test_no_text_overlaps_another() -> None:
    robot = large()
    names = [c.name for c in robot.components()]
    before = {name: f"c{place % 3}" for place, name in enumerate(names)}
    after = before | dict.fromkeys(names[:15], "c3")
    both = {"before": before, "after": after}
    for drawing in (
        *ALL,
        draw(robot),
        draw(robot, "deployment", both),
        draw(robot, "transition", both),
    ):
        found = boxes(drawing._repr_svg_())
        assert len(found) > 5
        for one, other in combinations(found, 2):
            assert not overlap(one, other), (one, other)


Box = tuple[float, float, float, float, str]


def boxes(svg: str) -> list[Box]:
    """Return about where each text is: left, top, right, bottom, and what it says."""
    found = []
    for text in ET.fromstring(svg).iter("{http://www.w3.org/2000/svg}text"):
        size, said = float(text.attrib["font-size"]), text.text or ""
        width, y = 0.5 * size * len(said), float(text.attrib["y"])
        left = float(text.attrib["x"])
        left -= width / 2 if text.attrib["text-anchor"] == "middle" else 0.0
        found.append((left, y - 0.7 * size, left + width, y, said))
    return found


def overlap(one: Box, other: Box) -> bool:
    """Return whether two boxes share room."""
    wide = min(one[2], other[2]) - max(one[0], other[0])
    high = min(one[3], other[3]) - max(one[1], other[1])
    return wide > 0 and high > 0
