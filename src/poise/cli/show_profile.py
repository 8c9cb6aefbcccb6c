"""A profile, for people."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from poise.estimate.predict import overheads
from poise.estimate.profile import ComponentProfile, Profile
from poise.estimate.rule import cpu_demand, memory_demand
from poise.manage.profiling import AGREE_CORES, AGREE_SHARE
from poise.model.robot import Robot
from poise.units import format_bytes, format_rate, format_seconds

_MOST_EARLIER = 4


def show_profile(robot: Robot, profile: Profile, console: Console) -> None:
    """Print a profile's components, timers and connectors."""
    console.print(
        f"robot '{profile.robot}' on '{profile.computer}' (speed {profile.speed:g}), "
        f"{profile.at}, Poise {profile.poise}, {profile.seconds:g} s each time"
    )
    console.print(_components(robot, profile))
    console.print(_timers(profile))
    console.print(_connectors(robot, profile))


def history_table(now: Profile, earlier: Sequence[Profile]) -> Table:
    """Return every component's CPU and memory by profile, newest first.

    Parameters
    ----------
    earlier
        Newest first. Those on another computer are left out, and so is `now` itself.
    """
    others = [
        each for each in earlier if each.computer == now.computer and each.at != now.at
    ][:_MOST_EARLIER]
    table = Table("component")
    for each in (now, *others):
        table.add_column(f"{each.at.removesuffix('+00:00')}\nPoise {each.poise}")
    for name, found in now.components.items():
        cells = [_brief(found)]
        newer = found
        for each in others:
            older = each.components.get(name)
            cells.append(_compared(older, newer) if older else "")
            newer = older or newer
        table.add_row(name, *cells)
    return table


def _brief(found: ComponentProfile) -> str:
    return f"{found.cpu.mean:.2%}, {format_bytes(found.memory)}"


def _compared(older: ComponentProfile, newer: ComponentProfile) -> str:
    """Return what was measured, marked where the code or the CPU changed since."""
    text = _brief(older)
    if older.version != newer.version:
        text += " other code"
    moved = abs(newer.cpu.mean - older.cpu.mean)
    if moved > max(AGREE_SHARE * older.cpu.mean, AGREE_CORES):
        return f"[yellow]{text}[/]"
    return text


def _components(robot: Robot, profile: Profile) -> Table:
    table = Table(
        "component", "mean", "p95", "p99", "peak", "sustained", "memory", "snapshot"
    )
    table.add_column("start")
    table.add_column("demand: CPU, memory")
    table.add_column("")
    for component in robot.components():
        found = profile.components.get(component.name)
        if found is not None:
            table.add_row(component.name, *_row(found))
    return table


def _row(found: ComponentProfile) -> list[str]:
    cpu = found.cpu
    shares = [f"{each:.1%}" for each in (cpu.p95, cpu.p99, cpu.peak, cpu.sustained)]
    error = f" ± {cpu.error:.1%}" if cpu.error is not None else ""
    return [
        f"{cpu.mean:.2%}{error}",
        *shares,
        format_bytes(found.memory),
        format_bytes(found.state) if found.state else "",
        format_seconds(found.start),
        f"{cpu_demand(found):.2%}, {format_bytes(memory_demand(found))}",
        "" if found.stable else f"[yellow]unstable: ± {found.repeat / 2:.1%}[/]",
    ]


def _timers(profile: Profile) -> Table:
    table = Table("timer", "period", "median", "p99", "longest", "missed")
    for name, component in profile.components.items():
        for timer, found in component.timers.items():
            table.add_row(
                f"{name}.{timer}",
                format_seconds(found.period),
                format_seconds(found.median),
                format_seconds(found.p99),
                format_seconds(found.maximum),
                f"{found.missed:.1%}",
            )
    return table


def _connectors(robot: Robot, profile: Profile) -> Table:
    unit = "0.01 cores" if profile.costs else "MB/s"
    table = Table("connector", "calls", "messages", "size", "traffic")
    table.add_column(f"overhead [{unit}]".replace("[", r"\["))
    relative = overheads(robot, profile)
    for name, found in profile.connectors.items():
        table.add_row(
            name,
            format_rate(found.calls) if found.calls else "",
            format_rate(found.messages) if found.messages else "",
            format_bytes(found.size),
            f"{format_bytes(found.traffic)}/s",
            f"{relative.get(name, 0.0):.3g}",
        )
    return table
