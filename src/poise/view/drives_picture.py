"""Drives as one SVG picture: the paths, missed deadlines, and CPU used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from xml.sax.saxutils import escape

from msgspec import Struct

_COLOURS = ("#c0392b", "#1f77b4", "#2e8b57", "#8e44ad")
_SCALE = 55.0
"""Pixels of a metre."""
_LEFT, _TOP, _BARS = 30.0, 50.0, 230.0

Points = Sequence[Sequence[float]]


class DrivePicture(Struct, frozen=True, kw_only=True):
    """What is drawn of a drive.

    Parameters
    ----------
    path
        x, y [m] of its points.
    shares
        What a bar is of -> how long it is, 0 to 1.
    verdict
        What came of it, in words; empty: nothing is said.
    """

    title: str
    path: Points
    shares: Mapping[str, float]
    verdict: str = ""


def drives_picture(drives: Sequence[DrivePicture], walls: Points, goal: Points) -> str:
    """Return an SVG picture.

    Parameters
    ----------
    walls
        x, y of one end, x, y of the other [m], of each.
    goal
        x, y [m]; one point, or none.
    """
    points = [*(p for d in drives for p in d.path), *(w[:2] for w in walls)]
    points += [wall[2:] for wall in walls]
    xs, ys = [point[0] for point in points], [point[1] for point in points]
    wide, high = max(xs, default=1.0) * _SCALE, max(ys, default=1.0) * _SCALE

    def at(x: float, y: float) -> str:
        return f"{_LEFT + x * _SCALE:.1f},{_TOP + high - y * _SCALE:.1f}"

    parts = [_line((at(*wall[:2]), at(*wall[2:])), "#444", 5) for wall in walls]
    for point in goal:
        across, down = at(*point[:2]).split(",")
        parts.append(
            f'<circle cx="{across}" cy="{down}" r="14" fill="none" stroke="#2e8b57" '
            'stroke-width="3"/>'
        )
    right = _LEFT + wide + 40
    for number, drive in enumerate(drives):
        colour = _COLOURS[number % len(_COLOURS)]
        parts.append(_line([at(*point[:2]) for point in drive.path], colour, 3))
        top = _TOP + number * (30 + 24 * (len(drive.shares) + 1) + 20)
        parts.append(_text(right, top + 8, drive.title, colour, 16))
        for row, (label, share) in enumerate(drive.shares.items()):
            y = top + 32 + 24 * row
            length = _BARS * min(1.0, share)
            parts.append(
                f'<rect x="{right}" y="{y - 12:.1f}" width="{length:.1f}" height="17" '
                f'fill="{colour}" fill-opacity="0.35"/>'
            )
            parts.append(_text(right + 4, y + 1, f"{label}: {share:.0%}", "#222", 12))
        if drive.verdict:
            below = top + 33 + 24 * len(drive.shares)
            parts.append(_text(right + 4, below, drive.verdict, colour, 13))
    width, height = right + _BARS + 30, _TOP + high + 30
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" '
        f'height="{height:.0f}" font-family="sans-serif">'
        f'<rect width="100%" height="100%" fill="white"/>{"".join(parts)}</svg>\n'
    )


def _line(points: Sequence[str], colour: str, width: float) -> str:
    return (
        f'<polyline points="{" ".join(points)}" fill="none" stroke="{colour}" '
        f'stroke-width="{width}" stroke-linejoin="round"/>'
    )


def _text(x: float, y: float, text: str, colour: str, size: int) -> str:
    return (
        f'<text x="{x:.0f}" y="{y:.0f}" fill="{colour}" font-size="{size}">'
        f"{escape(text)}</text>"
    )
