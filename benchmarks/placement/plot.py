"""A log-log plot of growth, as SVG."""

from __future__ import annotations

from math import log10
from pathlib import Path
from typing import Any

WIDTH, HEIGHT, MARGIN = 560, 360, 60
COLOURS = {"greedy": "#c44", "multilevel": "#36c"}


def growth(report: dict[str, Any], path: Path) -> None:
    """Write time against components, both logarithmic, one line a method."""
    points = report["points"]
    times = [p[f"{name}_seconds"] for p in points for name in COLOURS]
    x0, x1 = (log10(f(p["components"] for p in points)) for f in (min, max))
    y0, y1 = log10(min(times)) - 0.2, log10(max(times)) + 0.2

    def place(components: float, seconds: float) -> tuple[float, float]:
        x = MARGIN + (log10(components) - x0) / (x1 - x0) * (WIDTH - 2 * MARGIN)
        y = HEIGHT - MARGIN - (log10(seconds) - y0) / (y1 - y0) * (HEIGHT - 2 * MARGIN)
        return round(x, 1), round(y, 1)

    head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT}"'
    parts = [
        f'{head} font-family="sans-serif" font-size="12">',
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>',
    ]
    for p in points:
        x, _ = place(p["components"], times[0])
        label = f"{p['components']:,}"
        parts.append(
            f'<text x="{x}" y="{HEIGHT - 35}" text-anchor="middle">{label}</text>'
        )
    for power in range(int(y0) - 1, int(y1) + 2):
        if y0 <= power <= y1:
            _, y = place(points[0]["components"], 10**power)
            parts.append(f'<text x="8" y="{y + 4}">1e{power} s</text>')
            ends = f'x1="{MARGIN}" x2="{WIDTH - 20}" y1="{y}" y2="{y}"'
            parts.append(f'<line {ends} stroke="#ddd"/>')
    for i, (name, colour) in enumerate(COLOURS.items()):
        line = [place(p["components"], p[f"{name}_seconds"]) for p in points]
        path_points = " ".join(f"{x},{y}" for x, y in line)
        parts.append(
            f'<polyline points="{path_points}" fill="none" stroke="{colour}" '
            'stroke-width="2"/>'
        )
        parts += [f'<circle cx="{x}" cy="{y}" r="3" fill="{colour}"/>' for x, y in line]
        corner = f'x="{MARGIN + 10}" y="{MARGIN - 25 + 16 * i}"'
        parts.append(f'<text {corner} fill="{colour}">{name}</text>')
    parts.append(f'<text x="{WIDTH / 2}" y="{HEIGHT - 12}">components</text></svg>')
    path.write_text("\n".join(parts), encoding="utf-8")
