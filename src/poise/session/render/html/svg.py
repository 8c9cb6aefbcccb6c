"""Elements of SVG pictures that stand alone; lengths are in pixels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

Point = tuple[float, float]


def svg(width: float, height: float, label: str, parts: Iterable[str]) -> str:
    """Return a picture as wide as there is room; `label` says what it shows."""
    return (
        f'<svg viewBox="0 0 {width:.0f} {height:.0f}" role="img" font-size="13" '
        f'aria-label="{escape(label)}">{"".join(parts)}</svg>'
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
