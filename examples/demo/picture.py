"""Drives as one SVG picture: the paths, missed deadlines, and CPU used.

It imports internal modules: it draws as reports do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from msgspec import Struct

from poise.session.render.picture import line, text

_COLOURS = ("#c0392b", "#1f77b4", "#2e8b57", "#8e44ad")
_SCALE = 55.0
"""Pixels of a metre."""
_LEFT, _TOP, _BARS = 30.0, 50.0, 230.0
_ROUND = 'stroke-linejoin="round"'

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
    """Return an SVG picture."""
    points = [*(p for d in drives for p in d.path), *(w[:2] for w in walls)]
    points += [wall[2:] for wall in walls]
    xs, ys = [point[0] for point in points], [point[1] for point in points]
    wide, high = max(xs, default=1.0) * _SCALE, max(ys, default=1.0) * _SCALE

    def at(x: float, y: float) -> tuple[float, float]:
        return _LEFT + x * _SCALE, _TOP + high - y * _SCALE

    parts = [line((at(*wall[:2]), at(*wall[2:])), "#444", 5) for wall in walls]
    for point in goal:
        across, down = at(*point[:2])
        parts.append(
            f'<circle cx="{across:.1f}" cy="{down:.1f}" r="14" fill="none" '
            'stroke="#2e8b57" stroke-width="3"/>'
        )
    right = _LEFT + wide + 40
    for number, drive in enumerate(drives):
        colour = _COLOURS[number % len(_COLOURS)]
        parts.append(line([at(*point[:2]) for point in drive.path], colour, 3, _ROUND))
        top = _TOP + number * (30 + 24 * (len(drive.shares) + 1) + 20)
        parts.append(text(right, top + 8, drive.title, fill=colour, font_size=16))
        for row, (label, share) in enumerate(drive.shares.items()):
            y = top + 32 + 24 * row
            length = _BARS * min(1.0, share)
            parts.append(
                f'<rect x="{right}" y="{y - 12:.1f}" width="{length:.1f}" height="17" '
                f'fill="{colour}" fill-opacity="0.35"/>'
            )
            parts.append(
                text(
                    right + 4, y + 1, f"{label}: {share:.0%}", fill="#222", font_size=12
                )
            )
        if drive.verdict:
            below = top + 33 + 24 * len(drive.shares)
            parts.append(
                text(right + 4, below, drive.verdict, fill=colour, font_size=13)
            )
    width, height = right + _BARS + 30, _TOP + high + 30
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" '
        f'height="{height:.0f}" font-family="sans-serif">'
        f'<rect width="100%" height="100%" fill="white"/>{"".join(parts)}</svg>\n'
    )
