import pytest
from msgspec.structs import replace

from poise.model.robot import Computer, Robot
from poise.session.profiling.figures import measure
from poise.wire.records.status_records import AgentSample
from tests.manage.observe.conftest import Sampler

ROBOT = Robot(
    name="r", computers=(Computer(name="a", capacity={"cpu": 1.0}, speed=0.5),)
)


def samples(steady: Sampler, seconds: float) -> list[AgentSample]:
    return [steady(5 + 0.1 * k) for k in range(round(10 * seconds) + 1)]


def test_measures_components_containers_and_agents(steady: Sampler) -> None:
    """The container's 32 % less 10 % and 20 % leaves 2 %."""
    found = measure(samples(steady, 10), ROBOT)
    assert found.cpu["eye"].mean == pytest.approx(0.1)
    assert found.cpu["mind"].peak == pytest.approx(0.2)
    assert found.cpu["mind"].windows == 100
    assert found.rest == pytest.approx({"see": 0.02})
    assert found.agents == pytest.approx({"a": 0.01})
    assert found.memory == {"see": 9e6}
    assert found.members == {"see": ("eye", "mind")}
    assert found.undone == {"eye": 0.0, "mind": 0.0}


def test_measures_rate_and_size_of_connectors(steady: Sampler) -> None:
    (found,) = measure(samples(steady, 10), ROBOT).connectors.values()
    assert found.messages == pytest.approx(10)
    assert (found.calls, found.size) == (0.0, 500.0)
    assert found.traffic == pytest.approx(5000)


def test_a_lost_sample_loses_nothing(steady: Sampler) -> None:
    kept = [s for k, s in enumerate(samples(steady, 10)) if k % 7]
    assert measure(kept, ROBOT).cpu["eye"].mean == pytest.approx(0.1)


def test_nothing_was_used_where_nothing_was_told() -> None:
    assert measure([], ROBOT).cpu == {}


@pytest.mark.parametrize(("busy", "undone"), [(0.3, 0.0), (0.48, 0.88)])
def test_jobs_of_who_waits_for_a_device_do_not_count_as_undone(
    steady: Sampler, busy: float, undone: float
) -> None:
    """Of 10 messages a second it takes one; its computer has half a core."""
    seen = []
    for sample in samples(steady, 10):
        (container,) = sample.containers
        eye = container.components[0]
        slow = replace(container, components=(replace(eye, done=eye.asked // 10),))
        seen.append(replace(sample, containers=(slow,), busy=busy * sample.at))
    assert measure(seen, ROBOT).undone["eye"] == pytest.approx(undone, abs=0.01)
