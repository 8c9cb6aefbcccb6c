"""Log-log plots of growth, as SVG."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil, floor, log10
from pathlib import Path
from typing import Any

WIDTH, HEIGHT, LEFT, TOP, BOTTOM = 330, 300, 62, 30, 50
COLOURS = {"greedy_seconds": "#c44", "multilevel_seconds": "#36c", "peak": "#383"}
PANELS = (
    ("CPU time [s]", "components", ("greedy_seconds", "multilevel_seconds")),
    (
        "CPU time [s], 100,000 components",
        "computers",
        ("greedy_seconds", "multilevel_seconds"),
    ),
    ("memory [bytes]", "components", ("peak",)),
)


def growth(report: dict[str, Any], path: Path) -> None:
    """Write time and memory against size, both logarithmic, a line a method."""
    size = f'width="{len(PANELS) * WIDTH}" height="{HEIGHT}"'
    fonts = 'font-family="sans-serif" font-size="11"'
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} {fonts}>',
        f'<rect {size} fill="white"/>',
    ]
    for i, (title, axis, names) in enumerate(PANELS):
        parts.append(f'<g transform="translate({i * WIDTH} 0)">')
        parts += _panel(title, axis, names, report)
        parts.append("</g>")
    path.write_text("\n".join([*parts, "</svg>"]), encoding="utf-8")


def _panel(
    title: str, axis: str, names: tuple[str, ...], report: dict[str, Any]
) -> Iterator[str]:
    points = report[axis]
    sizes = [p[axis] for p in points]
    values = [p[name] for p in points for name in names]
    x0, x1 = log10(min(sizes)), log10(max(sizes))
    y0, y1 = floor(log10(min(values))), ceil(log10(max(values)))

    def place(size: float, value: float) -> tuple[float, float]:
        x = LEFT + (log10(size) - x0) / (x1 - x0) * (WIDTH - LEFT - 40)
        y = HEIGHT - BOTTOM - (log10(value) - y0) / (y1 - y0) * (HEIGHT - TOP - BOTTOM)
        return round(x, 1), round(y, 1)

    yield f'<text x="{LEFT}" y="16">{title}</text>'
    yield f'<text x="{WIDTH / 2}" y="{HEIGHT - 12}">{axis}</text>'
    for size in sizes:
        x, _ = place(size, 10**y0)
        yield (
            f'<text x="{x}" y="{HEIGHT - BOTTOM + 16}" text-anchor="middle">'
            f"{size:,}</text>"
        )
    for power in range(y0, y1 + 1):
        _, y = place(sizes[0], 10**power)
        yield f'<text x="{LEFT - 8}" y="{y + 4}" text-anchor="end">1e{power}</text>'
        ends = f'x1="{LEFT}" x2="{WIDTH - 30}" y1="{y}" y2="{y}"'
        yield f'<line {ends} stroke="#ddd"/>'
    for i, name in enumerate(names):
        line = [place(p[axis], p[name]) for p in points]
        path = " ".join(f"{x},{y}" for x, y in line)
        colour = COLOURS[name]
        yield f'<polyline points="{path}" fill="none" stroke="{colour}"/>'
        for x, y in line:
            yield f'<circle cx="{x}" cy="{y}" r="3" fill="{colour}"/>'
        slope = report["slopes"][f"{name} against {axis}"]
        label = f"{name.partition('_')[0]}: power {slope:.2f}"
        corner = f'x="{LEFT + 8}" y="{TOP + 12 + 15 * i}"'
        yield f'<text {corner} fill="{colour}">{label}</text>'
