"""Draws a robot: the diagram, and its files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal

from msgspec import Struct

from poise.errors import UsageError
from poise.manage.migration.transition_plan import plan_transition
from poise.model.robot import Robot
from poise.session.diagrams.contents import (
    component_diagram,
    deployment_diagram,
    sequence_diagram,
)
from poise.session.diagrams.diagram_records import Diagram
from poise.session.diagrams.svg_notation import svg
from poise.session.diagrams.text_notations import mermaid, plantuml

What = Literal["components", "deployment", "transition"]
FORMATS: Mapping[str, Callable[[Diagram], str]] = {
    ".svg": svg,
    ".mmd": mermaid,
    ".puml": plantuml,
}
"""Ending of a file -> what writes the diagram."""


class Drawing(Struct, frozen=True):
    """A diagram, to be written to files; Jupyter shows it as a picture."""

    diagram: Diagram

    def save(self, path: Path | str) -> None:
        """Write it to a file that ends in ``.svg``, ``.mmd`` or ``.puml``.

        Raises
        ------
        UsageError
            It ends otherwise.
        """
        path = Path(path)
        if path.suffix not in FORMATS:
            raise UsageError(
                f"{path}: the name says the format, and ends in {', '.join(FORMATS)}"
            )
        path.write_text(self.text(path.suffix), encoding="utf-8")

    def text(self, ending: str = ".mmd") -> str:
        """Return it as SVG (``.svg``), Mermaid (``.mmd``) or PlantUML (``.puml``)."""
        return FORMATS[ending](self.diagram)

    def _repr_svg_(self) -> str:
        """Return it as SVG, for Jupyter."""
        return self.text(".svg")


def draw(
    robot: Robot,
    what: What = "components",
    placements: Mapping[str, Mapping[str, str]] | None = None,
    *,
    task: str | None = None,
) -> Drawing:
    """Return a UML diagram of a robot.

    Parameters
    ----------
    what
        ``components``: the architectures and how their components are joined;
        ``deployment``: what runs where, several placements side by side;
        ``transition``: what happens on the way from one placement to another.
    placements
        Name -> placement (component -> computer), such as `Placement.where` or that of
        a running robot's status. A transition has two, before and after.
    task
        Only what it needs is among the ``components``; None: all.

    Raises
    ------
    UsageError
        There is no such task, or placements are missing.
    RobotError
        No transition leads to the second placement; the message says why.
    """
    named = placements or {}
    if what == "components":
        if task is not None and task not in {each.name for each in robot.tasks}:
            raise UsageError(f"robot '{robot.name}' has no task '{task}'")
        functions = None if task is None else robot.functions_of(task)
        return Drawing(component_diagram(robot, functions))
    if what == "deployment" and named:
        return Drawing(deployment_diagram(robot, named))
    if what == "transition" and len(named) == 2:  # noqa: PLR2004
        now, then = named.values()
        steps = plan_transition(robot, now, then)
        return Drawing(sequence_diagram(robot, " → ".join(named), steps))
    raise UsageError(
        "a deployment diagram is of one placement or more, a transition of two: "
        f"{what} was given {len(named)}"
    )
