"""The pictures of the experiment's page, as SVG that stands alone. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape

from poise.session.experiment.summary import Share
from poise.session.render.html.svg import line, svg, text

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
        parts.append(text(0, y, function, font_weight="bold"))
        for number, (arm, share) in enumerate(arms.items()):
            parts += _dot(arm, share, y, _COLOURS[number % len(_COLOURS)])
            y += _ROW
        y += _ROW / 2
    for tenth in (0, 0.25, 0.5, 0.75, 1):
        x = _x(tenth)
        parts.insert(0, line([(x, 8), (x, y - _ROW)], "#8884"))
        parts.append(text(x, y + 4, f"{tenth:.0%}", text_anchor="middle"))
    return svg(_WIDTH, y + 16, "how often each function worked", parts)


def _dot(arm: str, share: Share, y: float, colour: str) -> Iterator[str]:
    yield text(_LEFT + 140, y, arm, text_anchor="end")
    if share.share is None:
        yield text(_x(0) + 6, y, "no valid run")
        return
    yield line([(_x(share.low), y - 4), (_x(share.high), y - 4)], colour, 3)
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
    points = [point for each in lines.values() for point in each]
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
        parts.append(line([(60, y), (_WIDTH - 220, y)], "#8884"))
        parts.append(text(52, y + 4, f"{share:.0%}", text_anchor="end"))
    for load in sorted({x for x, _ in points}):
        x, _ = at(load, 0)
        parts.append(text(x, bottom + 18, f"{load:.0%}", text_anchor="middle"))
    parts.append(text(60, height - 4, unit))
    for number, (arm, shares) in enumerate(lines.items()):
        colour = _COLOURS[number % len(_COLOURS)]
        parts.append(line([at(*point) for point in shares], colour, 2.5))
        y = top + 12 + number * _ROW
        parts.append(line([(_WIDTH - 200, y - 4), (_WIDTH - 170, y - 4)], colour, 3))
        parts.append(text(_WIDTH - 162, y, arm))
    return svg(_WIDTH, height, label, parts)
