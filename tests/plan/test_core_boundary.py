"""The boundary of the C++ core: whatever comes in, an error or an answer comes out."""

from collections.abc import Callable, Iterable
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from poise.plan._core import Core

GOOD: dict[str, Any] = {
    "n": 2,
    "m": 2,
    "r": 1,
    "index": {"a": 0, "b": 1},
    "unit_of": [0, 1],
    "resources": ("cpu",),
    "component_demand": [1.0, 1.0],
    "capacity": [2.0, 2.0],
    "limit": [2.0, 2.0],
    "price": [0.0],
    "size_weight": [1.0],
    "allowed": {0: (1,)},
    "connectors": [(0, 1, 1.0, 0.0)],
    "distance": [],
    "cost": [],
    "bandwidth": [],
    "apart": [],
    "communication": 0.5,
    "spread": [0.5],
    "share": True,
    "variance": False,
    "times": None,
}
FIELDS = sorted(GOOD.keys() - {"times"})
TIMES: dict[str, Any] = {
    "limits": [(1.0, 0.0, 0.1, 0, [(0, 0.1), (1, 0.2)], [(0, 1, 0.1, 1.0, 8.0)])],
    "speed": [1.0, 2.0],
    "cores": [1, 2],
    "power": [1, 1],
    "latency": [0.0, 0.1, 0.1, 0.0],
    "per_byte": [],
}


def core_of(**wrong: Any) -> Core:
    """Return the core of two components on two computers, but for what is wrong."""
    return Core(SimpleNamespace(**{**GOOD, **wrong}))


def timed(**wrong: Any) -> Core:
    """Return it with a time limit, but for what is wrong with that."""
    return core_of(times=SimpleNamespace(**{**TIMES, **wrong}))


NUMBERS = st.one_of(
    st.floats(), st.integers(-3, 3), st.sampled_from([1 << 31, 1 << 63, -1, 1 << 80])
)
BUFFERS = st.builds(
    lambda values, kind: np.array(values).astype(kind),
    st.lists(st.sampled_from([0.0, 1.0, 2.0]), max_size=4),
    st.sampled_from(["f8", "f4", "i4", "i8", "u1", ">f8", "c16", "?", "U3", "O"]),
)
ODD = st.sampled_from([np.ones((2, 1)), np.arange(4.0)[::2], b"12345678", 10**5000])
ANYTHING = st.one_of(
    st.none(),
    NUMBERS,
    st.text(max_size=3),
    st.lists(NUMBERS, max_size=5),
    st.booleans(),
    BUFFERS,
    ODD,
)


REFUSALS = TypeError, ValueError, OverflowError, MemoryError, RuntimeError


def answers(calls: Iterable[Callable[[], object]]) -> int:
    """Make all calls; return how many had an answer, where the others were refused."""
    count = 0
    for call in calls:
        with suppress(*REFUSALS):
            call()
            count += 1
    return count


def calls_of(core: Core) -> list[Callable[[], object]]:
    """Return calls of a core with right arguments."""
    return [
        core.greedy,
        core.bound,
        lambda: core.exact([], 0.01, 1000),
        lambda: core.search([], 0.01, 1000, 1),
        lambda: core.updated({"a": {"cpu": 2.0}}).greedy(),
        lambda: core.terms([1, 0]),
        lambda: core.feasible([1, 0]),
    ]


def calls_with(core: Core, value: Any) -> list[Callable[[], object]]:
    """Return calls of a core, each with the same argument, right or wrong."""
    return [
        lambda: core.updated(value),
        lambda: core.exact(value, 0.01, 1000),
        lambda: core.search(value, 0.01, 1000, 1),
        lambda: core.terms(value),
        lambda: core.feasible(value),
    ]


def test_every_call_with_right_arguments_has_an_answer() -> None:
    """Else the tests that suppress refusals would test nothing."""
    core, with_times = core_of(), timed()
    assert answers(calls_of(core)) == answers(calls_of(with_times)) == 7
    assert answers(calls_with(core, [1, 0])) == 4  # `updated` takes demands
    assert answers(calls_with(core, {"a": {"cpu": 2.0}})) == 1


@pytest.mark.slow
@given(st.dictionaries(st.sampled_from(FIELDS), ANYTHING, max_size=3), ANYTHING)
def test_nothing_crashes_the_interpreter(wrong: dict[str, Any], value: object) -> None:
    with suppress(*REFUSALS):
        answers(calls_of(core_of(**wrong)))
    answers(calls_with(core_of(), value))


@pytest.mark.slow
@given(st.dictionaries(st.sampled_from(sorted(TIMES)), ANYTHING, max_size=2))
def test_no_time_limit_crashes_the_interpreter(wrong: dict[str, Any]) -> None:
    with suppress(*REFUSALS):
        answers(calls_of(timed(**wrong)))


EXTREME = st.sampled_from([0.0, 5e-324, 1e-300, 0.5, 1.0, 2.0, 1e60, 1e150])


@pytest.mark.slow
@given(st.data())
def test_every_shape_and_size_has_an_answer(data: st.DataObject) -> None:
    n, m, r = (data.draw(st.integers(low, 4)) for low in (0, 1, 0))
    edges = data.draw(st.integers(0, 5)) if n else 0

    def numbers(count: int) -> list[float]:
        return data.draw(st.lists(EXTREME, min_size=count, max_size=count))

    def units() -> list[int]:
        unit = st.integers(0, max(n - 1, 0))
        return data.draw(st.lists(unit, min_size=edges, max_size=edges))

    core = core_of(
        n=n,
        m=m,
        r=r,
        index={str(i): i for i in range(n)},
        unit_of=list(range(n)),
        resources=tuple(map(str, range(r))),
        component_demand=numbers(n * r),
        share=data.draw(st.booleans()),
        size_weight=numbers(r),
        spread=numbers(r),
        capacity=numbers(m * r),
        limit=numbers(m * r),
        price=numbers(r),
        allowed={},
        connectors=list(
            zip(units(), units(), numbers(edges), numbers(edges), strict=True)
        ),
        variance=data.draw(st.booleans()),
        bandwidth=numbers(m * m) if data.draw(st.booleans()) else [],
        apart=list(zip(some := units(), some[::-1], strict=True)),
    )
    known = data.draw(st.lists(st.integers(-1, m - 1), min_size=n, max_size=n))
    core.greedy()
    core.terms(known)
    core.feasible(known)
    core.bound()
    for placed in (
        core.exact([], 1.0, 500)[0],
        core.search([], 1.0, 500, 1)[0],
    ):
        assert len(placed) in {0, n}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"component_demand": [1.0]}, "component_demand has 1 entries, must have 2"),
        ({"connectors": [(7, 0, 1.0, 0.0)]}, "connectors has the index 7"),
        ({"allowed": {0: (-1,)}}, "allowed has the index -1"),
        ({"n": -1}, "n is -1"),
        ({"unit_of": [0, 7]}, "unit_of has the index 7"),
        ({"index": {"a": 0, "b": 9}}, "index has the index 9"),
    ],
)
def test_says_what_is_wrong(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        core_of(**wrong)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"limits": [(1.0, 0.0, 0.0, 1, [], [])]}, "cpu has the index 1"),
        ({"limits": [(1.0, 0.0, 0.0, 0, [(2, 0.1)], [])]}, "runs has the index 2"),
        (
            {"limits": [(1.0, 0.0, 0.0, 0, [], [(0, -1, 0.0, 0.0, 0.0)])]},
            "hops has the index -1",
        ),
        ({"power": [1, 1 << 30]}, "power has the index 1073741824"),
        ({"cores": [1]}, "cores and power must have 2 entries"),
        ({"latency": [0.0]}, "latency has 1 entries, must have 4"),
    ],
)
def test_says_what_is_wrong_with_a_time_limit(
    wrong: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        timed(**wrong)


def test_a_placement_of_some_units_is_not_feasible() -> None:
    """The core read the traffic of the unit that has no computer."""
    core = core_of(bandwidth=[9.0] * 4)
    assert not core.feasible([1, -1])
    assert core.feasible([1, 0])


def test_refuses_a_known_placement_that_breaks_a_limit() -> None:
    with pytest.raises(ValueError, match="breaks a limit"):
        core_of().exact([0, 0], 1.0, 10)
