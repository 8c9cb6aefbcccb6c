"""Computers with their components inside, as HTML that stands alone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import NamedTuple

from poise import plan

_BOX = (
    "display:inline-block;vertical-align:top;min-width:15em;margin:.3em;"
    "padding:.5em .7em;border:2px solid #888;border-radius:.4em;font-family:sans-serif"
)
_ROW = "display:flex;justify-content:space-between;gap:1em;font-size:90%"
_BAR = "height:3px;margin-bottom:3px"


class Hosted(NamedTuple):
    """A component on a computer, and the CPU that it takes there [cores]."""

    name: str
    computer: str
    cpu: float


def picture(shares: Mapping[str, float], hosted: Iterable[Hosted]) -> str:
    """Return a box for each computer, of share of CPU, with its components as bars."""
    placed = sorted(hosted, key=lambda each: (-each.cpu, each.name))
    most = max((each.cpu for each in placed), default=0.0)
    boxes = []
    for computer in dict.fromkeys([*shares, *sorted(each.computer for each in placed)]):
        share = shares.get(computer)
        rows = [
            bar_row(
                component.name,
                f"{component.cpu:.1%} of a core",
                component.cpu / most if most else 0.0,
            )
            for component in placed
            if component.computer == computer
        ]
        says = "CPU not known" if share is None else f"CPU {share:.0%}"
        full = " ▲ more than it has" if share is not None and share > 1 else ""
        head = bar_row(computer, says + full, share or 0.0, weight="bold")
        boxes.append(f'<div style="{_BOX}">{head}{"".join(rows)}</div>')
    return f"<div>{''.join(boxes)}</div>"


def planned_picture(result: plan.Result, title: str) -> str:
    """Return the picture of a planned placement; a title if there is one."""
    problem = result.problem
    hosted = [
        Hosted(
            component.name,
            result.placement[component.name],
            component.demand.get("cpu", 0.0),
        )
        for component in problem.components
        if component.name in result.placement
    ]
    if not hosted:
        return ""
    shares = {}
    for computer in problem.computers:
        used = sum(each.cpu for each in hosted if each.computer == computer.name)
        has = computer.total("cpu")
        shares[computer.name] = used / has if has else 0.0
    head = f"<p><b>{escape(title)}</b></p>" if title else ""
    return head + picture(shares, hosted)


def bar_row(name: str, value: str, share: float, weight: str = "normal") -> str:
    """Return a name and a value above a bar that is as long as the share says."""
    colour = "#c0392b" if share > 1 else "#3b7dd8"
    bar = f"{_BAR};width:{min(share, 1):.1%};background:{colour}"
    return (
        f'<div style="{_ROW};font-weight:{weight}"><span>{escape(name)}</span>'
        f'<span>{escape(value)}</span></div><div style="{bar}"></div>'
    )


Point = tuple[float, float]


def svg(width: float, height: float, label: str, parts: Iterable[str]) -> str:
    """Return a picture as wide as there is room; `label` says what it shows."""
    return (
        f'<div style="overflow-x:auto"><svg viewBox="0 0 {width:.0f} {height:.0f}" '
        f'style="min-width:{0.75 * width:.0f}px" role="img" font-size="13" '
        f'aria-label="{escape(label)}">{"".join(parts)}</svg></div>'
    )


def line(points: Sequence[Point], colour: str, width: float = 1, more: str = "") -> str:
    """Return a line through points; `more` are further attributes."""
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return (
        f'<polyline points="{path}" fill="none" stroke="{colour}" '
        f'stroke-width="{width:g}"{more and " " + more}/>'
    )


def text(x: float, y: float, words: str, **more: object) -> str:
    """Return a text that begins at a point; `more` are further attributes."""
    said = "".join(f' {n.replace("_", "-")}="{v}"' for n, v in more.items())
    return f'<text x="{x:.1f}" y="{y:.1f}"{said}>{escape(words)}</text>'
