"""Drives side by side as one SVG picture: path, computers, and functions that worked.

It imports internal modules: it draws as reports do.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from msgspec import Struct

from poise.session.render.picture import line, text

_PANEL, _GAP, _MARGIN = 440.0, 40.0, 24.0
_GOOD, _BAD, _INK, _PALE = "#2e7d32", "#c62828", "#263238", "#cfd8dc"
_SQUARE, _IN_A_ROW = 15.0, 11
_BOX, _BOX_GAP = 210.0, 20.0
_FULL = 0.95
"""A computer that uses more of its CPU has no time left."""

NAVIGATOR = (
    "laser_scanner",
    "localiser",
    "mapper",
    "path_planner",
    "motion_controller",
)


class DrivePicture(Struct, frozen=True, kw_only=True):
    """What is drawn of a drive.

    Parameters
    ----------
    verdict
        What came of it, in words, and whether that `is_good`.
    world
        What the simulated home said last: ``path``, ``walls``, ``goal``, ``functions``.
    cpu
        Computer -> share of its CPU that was used.
    placement
        Component -> computer.
    late
        The share of the navigator's checks that found too old a pose.
    """

    title: str
    verdict: str
    is_good: bool
    world: Mapping[str, Any]
    cpu: Mapping[str, float]
    placement: Mapping[str, str]
    late: float


def drives_picture(drives: Sequence[DrivePicture]) -> str:
    """Return an SVG picture with a panel for each drive."""
    walls = next((d.world["walls"] for d in drives if "walls" in d.world), ())
    panels = [list(_panel(drive, walls)) for drive in drives]
    bottom = max(height for _, height in (panel[-1] for panel in panels))
    width = 2 * _MARGIN + len(drives) * (_PANEL + _GAP) - _GAP
    shown = "".join(
        f'<g transform="translate({_MARGIN + n * (_PANEL + _GAP):.0f},0)">'
        f"{''.join(part for part, _ in panel)}</g>"
        for n, panel in enumerate(panels)
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" '
        f'height="{bottom + _MARGIN:.0f}" font-family="sans-serif">'
        f'<rect width="100%" height="100%" fill="white"/>{shown}</svg>\n'
    )


def _panel(drive: DrivePicture, walls: Sequence[Sequence[float]]) -> _Parts:
    """Yield parts of a drive's panel, each with how far down it reaches."""
    colour = _GOOD if drive.is_good else _BAD
    yield text(0, 36, drive.title, fill=_INK, font_size=20, font_weight="bold"), 36
    mark = "✓" if drive.is_good else "✗"
    verdict = f"{mark} {drive.verdict}"
    yield text(0, 66, verdict, fill=colour, font_size=20), 66
    late = f"the pose was too old at {drive.late:.0%} of the navigator's checks"
    yield text(0, 88, late, fill=_INK, font_size=13), 88
    plan = list(_floor_plan(drive.world, walls, colour, 104))
    yield from plan
    down = plan[-1][1] + 30
    for n, name in enumerate(drive.cpu):
        inside = [c for c, computer in drive.placement.items() if computer == name]
        yield from _computer(name, drive.cpu[name], inside, n * (_BOX + _BOX_GAP), down)
    legend = down + 104
    yield _square(0, legend - 11, colour=_INK), legend
    yield text(20, legend, "a component of the navigator", font_size=12), legend
    yield from _functions(drive.world.get("functions", {}), legend + 28)


_Parts = Iterator[tuple[str, float]]


def _floor_plan(
    world: Mapping[str, Any],
    walls: Sequence[Sequence[float]],
    colour: str,
    top: float,
) -> _Parts:
    path: Sequence[Sequence[float]] = world.get("path", ())
    ends = [(*wall[:2],) for wall in walls] + [(*wall[2:],) for wall in walls]
    points = [*ends, *((point[0], point[1]) for point in path)] or [(1.0, 1.0)]
    wide, high = max(x for x, _ in points), max(y for _, y in points)
    scale = _PANEL / wide

    def at(x: float, y: float) -> tuple[float, float]:
        return x * scale, top + (high - y) * scale

    bottom = top + high * scale
    for wall in walls:
        yield line((at(*wall[:2]), at(*wall[2:])), "#78909c", 4), bottom
    if "goal" in world:
        x, y = at(*world["goal"][:2])
        yield _ring(x, y, 13, _GOOD), bottom
        yield text(x - 13, y + 30, "goal", fill=_GOOD, font_size=13), bottom
    if path:
        round_ = 'stroke-linejoin="round" stroke-linecap="round"'
        drawn = [at(*point[:2]) for point in path]
        yield line(drawn, colour, 6, round_), bottom
        yield _dot(*drawn[0], 5, _INK), bottom
        yield _dot(*drawn[-1], 9, colour), bottom
    yield "", bottom


def _computer(
    name: str, cpu: float, components: Sequence[str], left: float, top: float
) -> _Parts:
    """Yield a box: the computer's name, its CPU as a bar, a square per component."""
    colour = _BAD if cpu > _FULL else _GOOD
    label = f"{name}: {cpu:.0%} of its CPU"
    yield text(left, top, label, fill=_INK, font_size=13), top
    for length, shade in (1.0, _PALE), (min(1.0, cpu), colour):
        bar = _rectangle(left, top + 8, length * _BOX, 10, shade)
        yield bar, top + 18
    for n, component in enumerate(sorted(components, key=_navigator_first)):
        row, column = divmod(n, _IN_A_ROW)
        x, y = left + column * (_SQUARE + 4), top + 28 + row * (_SQUARE + 4)
        shade = _INK if component in NAVIGATOR else "#90a4ae"
        yield _square(x, y, colour=shade, title=component), y + _SQUARE


def _navigator_first(component: str) -> bool:
    return component not in NAVIGATOR


def _functions(functions: Mapping[str, bool], top: float) -> _Parts:
    """Yield each function with a mark, three in a line."""
    for n, (name, works) in enumerate(functions.items()):
        row, column = divmod(n, 3)
        mark, colour = ("✓", _GOOD) if works else ("✗", _BAD)
        x, y = column * _PANEL / 3, top + 20 * row
        yield text(x, y, f"{mark} {name}", fill=colour, font_size=12), y


def _square(x: float, y: float, *, colour: str, title: str = "") -> str:
    named = f"<title>{title}</title>" if title else ""
    return (
        f'<rect x="{x:.1f}" y="{y:.1f}" width="{_SQUARE:g}" height="{_SQUARE:g}" '
        f'rx="3" fill="{colour}">{named}</rect>'
    )


def _rectangle(x: float, y: float, width: float, height: float, colour: str) -> str:
    return (
        f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:g}" '
        f'fill="{colour}"/>'
    )


def _ring(x: float, y: float, radius: float, colour: str) -> str:
    return (
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}" fill="none" '
        f'stroke="{colour}" stroke-width="3"/>'
    )


def _dot(x: float, y: float, radius: float, colour: str) -> str:
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}" fill="{colour}"/>'
