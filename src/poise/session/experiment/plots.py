"""The pictures of the experiment's page, as SVG that stands alone. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape

from poise.session.experiment.summary import Share

_COLOURS = (
    "#c0392b",
    "#e08214",
    "#8e44ad",
    "#7f8c8d",
    "#8c6d31",
    "#17becf",
    "#1f77b4",
    "#2e8b57",
)
_LEFT, _WIDTH, _ROW = 170.0, 960.0, 22.0


def intervals(shares: Mapping[str, Mapping[str, Share]]) -> str:
    """Return a dot with its interval for each function and arm.

    Parameters
    ----------
    shares
        Function -> arm -> how often it worked.
    """
    parts: list[str] = []
    y = _ROW
    for function, arms in shares.items():
        parts.append(_text(0, y, function, weight="bold"))
        for number, (arm, share) in enumerate(arms.items()):
            parts += _dot(arm, share, y, _COLOURS[number % len(_COLOURS)])
            y += _ROW
        y += _ROW / 2
    for tenth in (0, 0.25, 0.5, 0.75, 1):
        x = _x(tenth)
        parts.insert(0, _line(x, 8, x, y - _ROW, "#8884"))
        parts.append(_text(x, y + 4, f"{tenth:.0%}", anchor="middle"))
    return _svg(y + 16, "how often each function worked", parts)


def _dot(arm: str, share: Share, y: float, colour: str) -> Iterator[str]:
    yield _text(_LEFT + 140, y, arm, anchor="end")
    if share.share is None:
        yield _text(_x(0) + 6, y, "no valid run")
        return
    yield _line(_x(share.low), y - 4, _x(share.high), y - 4, colour, 3)
    yield (
        f'<circle cx="{_x(share.share):.1f}" cy="{y - 4:.1f}" r="5" fill="{colour}">'
        f"<title>{escape(f'{arm}: {share}')}</title></circle>"
    )


def _x(share: float) -> float:
    left = _LEFT + 150
    return left + share * (_WIDTH - left - 40)


def curves(
    lines: Mapping[str, Sequence[tuple[float, float]]], label: str, unit: str
) -> str:
    """Return a line for each arm over the load; both axes are shares.

    Parameters
    ----------
    lines
        Arm -> points (load, share).
    label, unit
        What the shares are of, and what the axis below is.
    """
    points = [point for line in lines.values() for point in line]
    if not points:
        return "<p>No valid run.</p>"
    low, high = min(x for x, _ in points), max(x for x, _ in points)
    height, bottom, top = 330.0, 290.0, 20.0

    def at(load: float, share: float) -> tuple[float, float]:
        along = (load - low) / (high - low) if high > low else 0.5
        return 60 + along * (_WIDTH - 280), bottom - share * (bottom - top)

    parts = []
    for share in (0, 0.25, 0.5, 0.75, 1):
        _, y = at(low, share)
        parts.append(_line(60, y, _WIDTH - 220, y, "#8884"))
        parts.append(_text(52, y + 4, f"{share:.0%}", anchor="end"))
    for load in sorted({x for x, _ in points}):
        x, _ = at(load, 0)
        parts.append(_text(x, bottom + 18, f"{load:.0%}", anchor="middle"))
    parts.append(_text(60, height - 4, unit))
    for number, (arm, line) in enumerate(lines.items()):
        colour = _COLOURS[number % len(_COLOURS)]
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in (at(*p) for p in line))
        parts.append(
            f'<polyline points="{path}" fill="none" stroke="{colour}" '
            'stroke-width="2.5"/>'
        )
        y = top + 12 + number * _ROW
        parts.append(_line(_WIDTH - 200, y - 4, _WIDTH - 170, y - 4, colour, 3))
        parts.append(_text(_WIDTH - 162, y, arm))
    return _svg(height, label, parts)


def _svg(height: float, label: str, parts: Sequence[str]) -> str:
    return (
        f'<svg viewBox="0 0 {_WIDTH:.0f} {height:.0f}" role="img" font-size="13" '
        f'aria-label="{escape(label)}">{"".join(parts)}</svg>'
    )


def _line(
    x1: float, y1: float, x2: float, y2: float, colour: str, width: float = 1
) -> str:
    return (
        f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" '
        f'stroke="{colour}" stroke-width="{width:g}"/>'
    )


def _text(
    x: float, y: float, text: str, *, anchor: str = "start", weight: str = "normal"
) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" '
        f'font-weight="{weight}">{escape(text)}</text>'
    )
