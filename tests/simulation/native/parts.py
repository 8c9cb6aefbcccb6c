"""Small simulated components, made by hand in an engine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from poise.simulation._engine import (
    Connector,
    Container,
    Cpu,
    Engine,
    Executor,
    Handler,
    Model,
    Sender,
)

LOCAL = 40e-6
"""From one process to another of the same computer [s]."""
Timer = tuple[str, float, float | None, Handler]
Chain = tuple[str, bool, float | None]


def model(
    engine: Engine,
    timers: Sequence[Timer] = (),
    takes: Mapping[str, Handler] | None = None,
    *,
    serves: Mapping[str, Handler] | None = None,
    factors: Sequence[float] = (),
    keep: Sequence[tuple[Sequence[str], int]] = (),
) -> Model:
    return engine.model(
        timers=timers,
        takes=takes or {},
        serves=serves or {},
        other=engine.handler(0.001),
        factors=factors,
        keep=keep,
        keep_other=50,
    )


def container(engine: Engine, computer: str = "a", cpu: Cpu | None = None) -> Container:
    """Return a container that has a computer of its own, unless it is told its CPU."""
    cpu = cpu or engine.cpu(1.0)
    return engine.container(cpu, computer, lambda: None, lambda: None)


def worker(
    place: Container,
    name: str,
    what: Model,
    chains: Sequence[Chain] = (),
    epoch: int = 0,
) -> Executor:
    """Return a component that works."""
    executor = place.add((name, epoch), id(place), what, chains)
    executor.set_wanted(True)
    executor.activate()
    return executor


def joined(  # noqa: PLR0913 - each is a choice of the test
    engine: Engine,
    source: Container,
    target: Container,
    ends: tuple[str, str],
    *,
    limit: float = 1.0,
    chain: str = "",
    epochs: tuple[int, int] = (0, 0),
    slot: str = "out",
) -> tuple[Sender, Connector]:
    """Return a connector of two components, and its sending end."""
    connector = engine.connector(
        name=slot,
        key=f"{slot}/{epochs}",
        slot=slot,
        source=(ends[0], epochs[0]),
        target=(ends[1], epochs[1]),
        computer=target.computer,
        is_direct=source is target,
        limit=limit,
        size=100.0,
        costs=(0.0, 0.0),
        carries=[chain] if chain else [],
        answers=[chain] if chain else [],
    )
    target.connect([connector])
    return source.add_sender(connector), connector


def advance(engine: Engine, until: float) -> None:
    """Let time pass, whatever there is to tell meanwhile."""
    while engine.run(until) < until:
        engine.notify()
