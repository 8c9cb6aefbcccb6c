"""A profile as a picture: SVG, PNG or PDF (extra `plot`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from poise.errors import UsageError
from poise.estimate.demands import cpu_demand, memory_demand
from poise.estimate.profiles import Profile

FORMATS = (".svg", ".png", ".pdf")
T = TypeVar("T")
_MIB = 2**20
_ROW = 0.24
"""Height of a row [inch]."""
_WIDTH = 14.0
_MOST_ROWS = 200
"""Of more components or connectors, the largest are drawn."""


def plot_profile(profile: Profile, overheads: Mapping[str, float], path: Path) -> None:
    """Draw what components and connectors needed, largest first."""
    if path.suffix not in FORMATS:
        raise UsageError(
            f"{path}: the name says the format, and ends in {', '.join(FORMATS)}"
        )
    try:
        import matplotlib as mpl  # noqa: PLC0415, an extra
        from matplotlib.figure import Figure  # noqa: PLC0415
    except ImportError as error:
        raise UsageError(
            f"{path}: plots need matplotlib: pip install 'poise[plot]'"
        ) from error
    timers = sum(len(c.timers) for c in profile.components.values())
    rows = max(len(profile.components), 3), max(len(profile.connectors), timers, 3)
    heights = [min(count, _MOST_ROWS) * _ROW + 1.2 for count in rows]
    # text stays text, to be searched for; the same profile makes the same file
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "poise"}):
        figure = Figure(figsize=(_WIDTH, sum(heights) + 0.6), layout="constrained")
        panels = figure.subplots(2, 2, height_ratios=heights)
        _draw_cpu(panels[0][0], profile)
        _draw_memory(panels[0][1], profile)
        _draw_timers(panels[1][0], profile)
        _draw_connectors(panels[1][1], profile, overheads)
        figure.suptitle(
            f"{profile.robot} on {profile.computer} (speed {profile.speed:g}), "
            f"{profile.at}, Poise {profile.poise}"
        )
        figure.savefig(path, metadata=None if path.suffix == ".png" else _NO_DATE)


_NO_DATE: dict[str, Any] = {"Date": None}


def _largest(parts: Mapping[str, T], size: Callable[[T], float]) -> dict[str, T]:
    return dict(sorted(parts.items(), key=lambda part: size(part[1]))[-_MOST_ROWS:])


def _draw_cpu(axes: Any, profile: Profile) -> None:  # noqa: ANN401, of a library
    largest = _largest(profile.components, lambda component: component.cpu.mean)
    names, cpus = [*largest], [component.cpu for component in largest.values()]
    axes.barh(
        names,
        [100 * cpu.mean for cpu in cpus],
        xerr=[100 * (cpu.error or 0.0) for cpu in cpus],
        color="tab:blue",
        label="mean ± 95 % confidence",
    )
    for label, mark, values in (
        ("p95 of 100 ms", "|", [cpu.p95 for cpu in cpus]),
        ("p99 of 100 ms", ":", [cpu.p99 for cpu in cpus]),
        ("peak of 100 ms", ">", [cpu.peak for cpu in cpus]),
        ("p95 of 2 s", "s", [cpu.sustained for cpu in cpus]),
        ("demand", "D", [*map(cpu_demand, largest.values())]),
    ):
        marker = {"marker": "." if mark == ":" else mark, "linestyle": "none"}
        axes.plot([100 * v for v in values], names, label=label, **marker)
    unstable = [name for name, component in largest.items() if not component.stable]
    title = f"; not stable: {', '.join(unstable)}" if unstable else ""
    _label(axes, f"CPU{title}", "% of a core of the reference computer")


def _draw_memory(axes: Any, profile: Profile) -> None:  # noqa: ANN401, as above
    largest = _largest(profile.components, memory_demand)
    names = [*largest]
    own = [component.memory / _MIB for component in largest.values()]
    base = [component.base / _MIB for component in largest.values()]
    axes.barh(names, own, color="tab:green", label="own, at most")
    axes.barh(names, base, left=own, color="tab:gray", label="part of the container")
    states = [component.state / _MIB for component in largest.values()]
    axes.plot(states, names, "k|", label="snapshot")
    _label(axes, "Memory", "MiB")


def _draw_timers(axes: Any, profile: Profile) -> None:  # noqa: ANN401, as above
    timers = [
        (f"{name}.{timer}", times)
        for name, component in profile.components.items()
        for timer, times in component.timers.items()
    ][-_MOST_ROWS:]
    names = [name for name, _ in timers]
    axes.barh(names, [1e3 * t.median for _, t in timers], label="median")
    axes.plot([1e3 * t.p99 for _, t in timers], names, "k|", label="p99")
    axes.plot([1e3 * t.maximum for _, t in timers], names, "r.", label="longest")
    axes.plot([1e3 * t.period for _, t in timers], names, "kx", label="period")
    if timers:
        axes.set_xscale("log")
    _label(axes, "Execution time of timers", "ms")


def _draw_connectors(
    axes: Any,  # noqa: ANN401, as above
    profile: Profile,
    overheads: Mapping[str, float],
) -> None:
    largest = _largest(profile.connectors, lambda connector: connector.traffic)
    names = [*largest]
    traffic = [connector.traffic / 1e3 for connector in largest.values()]
    axes.barh(names, traffic, color="tab:purple", label="traffic [kB/s]")
    unit = "0.01 cores" if profile.costs else "MB/s"
    values = [overheads.get(name, 0.0) for name in names]
    axes.plot(values, names, "k|", label=f"overhead [{unit}]")
    if any(traffic):
        axes.set_xscale("symlog", linthresh=0.01)
    _label(axes, "Connectors", "")


def _label(axes: Any, title: str, unit: str) -> None:  # noqa: ANN401, as above
    axes.set_title(title)
    axes.set_xlabel(unit)
    axes.set_xlim(left=axes.get_xlim()[0] if axes.get_xscale() == "log" else 0)
    axes.margins(y=0.01)
    axes.grid(axis="x", alpha=0.3)
    axes.tick_params(axis="y", labelsize=7)
    if axes.get_legend_handles_labels()[0]:
        # beside the panel, where it hides nothing
        beside = {"loc": "upper left", "bbox_to_anchor": (1, 1), "frameon": False}
        axes.legend(fontsize=7, **beside)
