"""A profile, for people."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from rich.console import RenderableType
from rich.table import Table

from poise.estimate.demands import cpu_demand, memory_demand, overheads
from poise.estimate.profiles import (
    ComponentProfile,
    ConnectorProfile,
    HandlerProfile,
    Profile,
)
from poise.model.robot import Robot
from poise.session.profiling.figures import AGREE_CORES, AGREE_SHARE
from poise.session.render.tables import NamedRows, filled, table
from poise.units import format_bytes, format_seconds

_MOST_EARLIER = 2


def profile_parts(robot: Robot, profile: Profile) -> Iterator[RenderableType]:
    """Yield a profile's components, timers and connectors, and what is doubtful."""
    yield (
        f"robot '{profile.robot}' on '{profile.computer}' (speed {profile.speed:g}), "
        f"{profile.at}, Poise {profile.poise}, {profile.seconds:g} s each time"
    )
    found = {
        component.name: profile.components[component.name]
        for component in robot.components()
        if component.name in profile.components
    }
    yield _cpu(found)
    yield _needs(found)
    yield from filled(_timers(found), _waits(profile))
    connectors = _connectors(robot, profile)
    if connectors.row_count:
        yield connectors
        unit = "hundredths of a core" if profile.costs else "MB/s"
        yield f"overhead in {unit}, while the ends are apart"
    if little := ", ".join(name for name, each in found.items() if not each.memory):
        yield f"too little memory to tell from an empty container: {little}"
    for name, each in found.items():
        if not each.stable:
            yield f"[yellow]unstable: {name} ± {each.repeat / 2:.1%}[/]"
        for timer, times in each.timers.items():
            if not times.maximum:
                yield (
                    f"[yellow]not known: how long {name}.{timer} runs, as no run "
                    f"ended; measure for more than {format_seconds(times.period)}[/]"
                )


def history_table(now: Profile, earlier: Sequence[Profile]) -> Table:
    """Return components' CPU and memory by profile of this computer, newest first."""
    others = [
        each for each in earlier if each.computer == now.computer and each.at != now.at
    ][:_MOST_EARLIER]
    rows = table("component")
    for each in (now, *others):
        title = f"{each.at.removesuffix('+00:00')}\nPoise {each.poise}"
        rows.add_column(title, overflow="fold")
    for name, found in now.components.items():
        cells = [_brief(found)]
        newer = found
        for profile in others:
            older = profile.components.get(name)
            cells.append(_compared(older, newer) if older else "")
            newer = older or newer
        rows.add_row(name, *cells)
    return rows


def _brief(found: ComponentProfile) -> str:
    return f"{found.cpu.mean:.2%}, {_memory(found)}"


def _memory(found: ComponentProfile) -> str:
    return format_bytes(found.memory) if found.memory else "too little"


def _compared(older: ComponentProfile, newer: ComponentProfile) -> str:
    """Return what was measured, marked where the code or the CPU changed since."""
    text = _brief(older)
    if older.version != newer.version:
        text += " other code"
    moved = abs(newer.cpu.mean - older.cpu.mean)
    if moved > max(AGREE_SHARE * older.cpu.mean, AGREE_CORES):
        return f"[yellow]{text}[/]"
    return text


def _cpu(found: Mapping[str, ComponentProfile]) -> Table:
    rows = table("CPU of component", "mean", "p95", "p99", "peak", "sustained")
    for name, component in found.items():
        cpu = component.cpu
        error = f" ± {cpu.error:.1%}" if cpu.error is not None else ""
        shares = (f"{s:.1%}" for s in (cpu.p95, cpu.p99, cpu.peak, cpu.sustained))
        rows.add_row(name, f"{cpu.mean:.2%}{error}", *shares)
    return rows


def _needs(found: Mapping[str, ComponentProfile]) -> Table:
    rows = table("component", "memory", "snapshot", "start", "demand: CPU", "memory")
    for name, component in found.items():
        rows.add_row(
            name,
            _memory(component),
            format_bytes(component.state) if component.state else "",
            format_seconds(component.start),
            f"{cpu_demand(component):.2%}",
            format_bytes(memory_demand(component)),
        )
    return rows


def _timers(found: Mapping[str, ComponentProfile]) -> Table:
    rows = table("timer", "period", "median", "p99", "longest", "missed")
    for name, component in found.items():
        for timer, times in component.timers.items():
            head = f"{name}.{timer}", format_seconds(times.period)
            if times.maximum:
                taken = map(format_seconds, (times.median, times.p99, times.maximum))
                missed = "" if times.missed is None else f"{times.missed:.1%}"
                rows.add_row(*head, *taken, missed)
            else:
                rows.add_row(*head)
    return rows


def _handlers(profile: Profile) -> Iterator[tuple[str, HandlerProfile]]:
    for component, of_it in profile.components.items():
        for name, handler in of_it.handlers.items():
            yield f"{component}.{name}", handler
    for name, connector in profile.connectors.items():
        if connector.answering is not None:
            yield name, connector.answering


def _waits(profile: Profile) -> Table:
    rows = table("handler or call that waits", "CPU", "of all", "waits", "p99")
    for name, handler in _handlers(profile):
        if handler.waits:
            cpu, *waits = map(
                format_seconds, (handler.median, handler.wait, handler.wait_p99)
            )
            rows.add_row(name, cpu, f"{handler.waiting:.0%}", *waits)
    return rows


def _connectors(robot: Robot, profile: Profile) -> NamedRows:
    rows = NamedRows("connector", "a second", "size", "p99", "largest", "overhead")
    relative = overheads(robot, profile)
    for name, connector in profile.connectors.items():
        sizes = connector.median or connector.size, connector.p99, connector.largest
        rows.add_row(
            name,
            _rates(connector),
            *(format_bytes(size) if size else "" for size in sizes),
            f"{relative.get(name, 0.0):.3g}",
        )
    return rows


def _rates(found: ConnectorProfile) -> str:
    rates = {"calls": found.calls, "messages": found.messages}
    return ", ".join(f"{rate:.3g} {what}" for what, rate in rates.items() if rate)
