import pytest
from msgspec.structs import replace

from poise.errors import RunError
from poise.session.profiling.calibrate import EMPTY, PAIRS, TICKING, Pair, costs_of
from poise.wire.records.status_records import (
    AgentSample,
    ConnectorSample,
    ContainerSample,
)

PER_BYTE = {"direct": 0.0, "local": 1e-9, "remote": 1e-8}
FIXED = {"direct": 20e-6, "local": 100e-6, "remote": 200e-6}
IDLE = 0.003
"""What a container uses that does nothing [cores]."""
STEP = 90e-6
"""The CPU time of a step in which nothing is done [s]; each use is in a step."""


def spent(pair: Pair, end: str) -> float:
    """Return the CPU time of one use at an end [s]; a target's is half of it."""
    fixed = FIXED[pair.kind] * (2 if pair.how == "call" else 1)
    used = fixed + pair.size * PER_BYTE[pair.kind]
    return used if end == "source" else used / 2


def sample(at: float, uses: int, *, there: str = "there") -> list[AgentSample]:
    """Return what the pairs' computers tell at a moment, after so many uses each."""
    here = [
        container(EMPTY, at, IDLE * at, EMPTY, 0),
        container(TICKING, at, IDLE * at + uses * STEP, EMPTY, 0),
    ]
    other: list[ContainerSample] = []
    for pair in PAIRS:
        for name in pair.containers:
            end = "target" if name.endswith("target") else "source"
            cpu = IDLE * at + uses * (spent(pair, end) + STEP * (end == "source"))
            told = container(name, at, cpu, pair.how, uses)
            is_there = pair.kind == "remote" and end == "target"
            (other if is_there else here).append(told)
    return [
        AgentSample("here", at, 0.0, tuple(here)),
        AgentSample(there, at, 0.0, tuple(other)),
    ]


def container(name: str, at: float, cpu: float, how: str, uses: int) -> ContainerSample:
    calls, messages = (uses, 0) if how == "call" else (0, uses)
    connector = ConnectorSample("c", calls, messages, 0, 0, 0, 0)
    return ContainerSample(name, 1, at, cpu, 0, (), (connector,))


SPEEDS = {"here": 1.0, "there": 1.0}


def test_finds_what_each_end_of_each_kind_costs() -> None:
    found = costs_of([*sample(1.0, 0), *sample(9.0, 400)], SPEEDS)
    assert list(found) == ["direct", "local", "remote"]
    for kind, costs in found.items():
        assert costs.source.call == pytest.approx(2 * FIXED[kind])
        assert costs.source.message == pytest.approx(FIXED[kind])
        assert costs.source.byte == pytest.approx(PER_BYTE[kind])
    assert found["remote"].target.message == pytest.approx(FIXED["remote"] / 2)
    assert found["direct"].target.call == 0  # in the source's process


def test_the_last_of_a_start_does_not_count() -> None:
    samples = [*sample(1.0, 0), *sample(3.0, 100), *sample(5.0, 200), *sample(7.0, 300)]
    late = [
        replace(each, containers=tuple(map(started, each.containers)))
        for each in samples[2:]
    ]
    found = costs_of([*samples[:2], *late], SPEEDS)
    assert found["remote"].source.call == pytest.approx(2 * FIXED["remote"])


def started(container: ContainerSample) -> ContainerSample:
    """Return what the one that ticks tells when it was still starting until then."""
    return replace(container, cpu=container.cpu + 0.5 * (container.name == TICKING))


def test_does_not_believe_that_a_connector_costs_nothing() -> None:
    samples = [*sample(1.0, 0), *map(busy, sample(9.0, 400))]
    with pytest.raises(
        RunError,
        match=r"a local connector .* a longer --for",
    ):
        costs_of(samples, SPEEDS)


def busy(told: AgentSample) -> AgentSample:
    return replace(told, containers=tuple(map(started, told.containers)))


def test_counts_in_cores_of_the_reference_computer() -> None:
    """The other computer is half as fast: its second is half a reference second."""
    samples = [*sample(1.0, 0), *sample(9.0, 400)]
    found = costs_of(samples, {"here": 1.0, "there": 0.5})
    assert found["remote"].source.message == pytest.approx(FIXED["remote"])
    assert found["remote"].target.message == pytest.approx(FIXED["remote"] / 4)


def test_one_computer_tells_nothing_of_remote_ones() -> None:
    samples = [*sample(1.0, 0, there="here"), *sample(9.0, 400, there="here")]
    assert list(costs_of(samples, SPEEDS)) == ["direct", "local"]


@pytest.mark.parametrize(
    ("samples", "says"),
    [
        ([], "'empty' sent no samples"),
        (sample(1.0, 0), "'empty' sent no samples"),
        ([*sample(1.0, 5), *sample(2.0, 5)], "'direct-call-100' did not communicate"),
    ],
)
def test_says_what_told_nothing(samples: list[AgentSample], says: str) -> None:
    with pytest.raises(RunError, match=says):
        costs_of(samples, SPEEDS)
