"""How long things take on a placement, and what keeps them in time."""

from __future__ import annotations

from math import inf, nan
from pathlib import Path

import msgspec
import pytest
from msgspec.structs import replace

from poise import plan
from poise.errors import RobotError
from poise.model.robot import Computer, Link
from poise.plan import Bundle, Edge, Hop, Item, Planner, Problem, Run, TimeLimit
from poise.plan.summed_times import slowdown

SEE = TimeLimit(
    name="see",
    limit=0.1,
    runs=(Run(component="camera", seconds=0.01), Run(component="finder", seconds=0.02)),
    hops=(Hop(between=("camera", "finder"), seconds=0.001, size=1e5),),
)


def robot(limit: TimeLimit = SEE, cores: float = 1.0, **more: object) -> Problem:
    """Return a camera on `head`, and a finder that may also run on the quicker `base`.

    The link has a latency of 5 ms and carries 1 MB/s.
    """
    made = Problem(
        components=(
            Item(name="camera", demand={"cpu": 0.3}, only=("head",)),
            Item(name="finder", demand={"cpu": 0.5}),
        ),
        computers=(
            Computer(name="head", capacity={"cpu": cores}),
            Computer(name="base", capacity={"cpu": cores}, speed=2.0),
        ),
        connectors=(Edge(between=("camera", "finder")),),
        links=(Link(between=("head", "base"), latency=0.005, bandwidth=1e6),),
        time_limits=(limit,),
    )
    return replace(made, **more)


BESIDE = {"camera": "head", "finder": "head"}
APART = {"camera": "head", "finder": "base"}


def seconds(problem: Problem, placement: dict[str, str]) -> float:
    (time,) = plan.evaluate(problem, placement).times
    return time.seconds


def test_runs_take_less_on_quicker_computers_and_hops_only_between_two() -> None:
    """Beside: 10 + 20 ms. Apart: 10 + 20 / 2 + 1 + 5 ms + 100 kB at 1 MB/s = 126 ms."""
    assert seconds(robot(), BESIDE) == pytest.approx(0.03)
    assert seconds(robot(), APART) == pytest.approx(0.126)


def test_a_call_waits_for_the_latency_twice() -> None:
    call = Hop(between=("camera", "finder"), crossings=2.0)
    only = TimeLimit(name="ask", limit=1.0, fixed=0.5, hops=(call,))
    assert seconds(robot(only), APART) == pytest.approx(0.51)
    assert seconds(robot(only, links=()), APART) == 0.5


def test_shared_runs_take_longer_the_busier_their_computer_is() -> None:
    """On one core 1 + u / (1 - u): twice as long beside 0.5, the camera's part."""
    shared = robot(replace(SEE, shared=True))
    assert seconds(shared, BESIDE) == pytest.approx(0.01 * 2 + 0.02 * (1 + 0.3 / 0.7))
    assert seconds(shared, APART) == pytest.approx(seconds(robot(), APART))


def test_four_cores_keep_less_waiting_and_beyond_nine_tenths_it_is_a_line() -> None:
    """Four: 1 + 0.5^2 / (4 * 0.5). One at 1.4: 10 at 0.9, with a slope of 100."""
    assert slowdown(0.5, 4, 2) == pytest.approx(1.125)
    assert slowdown(0.9, 1, 1) == pytest.approx(10)
    assert slowdown(1.4, 1, 1) == pytest.approx(60)
    problem = robot(replace(SEE, shared=True), cores=4.0)
    use = {"camera": 0.5 / 4, "finder": 0.3 / 4}
    takes = {name: 1 + u**2 / (4 * (1 - u)) for name, u in use.items()}
    expected = 0.01 * takes["camera"] + 0.02 * takes["finder"]
    assert seconds(problem, BESIDE) == pytest.approx(expected)


def test_new_demands_keep_others_waiting() -> None:
    planner = Planner(robot(replace(SEE, shared=True, limit=0.04)))
    assert planner.decide().proven
    assert not planner.decide().feasible  # 48.6 ms beside, 126 ms apart
    planner.update({"finder": {"cpu": 0.1}})
    found = planner.decide()
    assert found.placement == BESIDE
    takes = 0.01 * (1 + 0.1 / 0.9) + 0.02 * (1 + 0.3 / 0.7)
    assert found.times[0].seconds == pytest.approx(takes)


@pytest.mark.parametrize("method", ["greedy", "exact", "search", "auto"])
def test_every_solver_keeps_what_must_be_kept(method: str) -> None:
    """Apart is better by load, but takes 126 ms."""
    free = robot(replace(SEE, limit=0.2), connectors=())
    assert plan.solve(free, method=method, steps=2000).placement == APART
    tight = robot(connectors=())
    assert plan.solve(tight, method=method, steps=2000).placement == BESIDE


def test_what_is_late_costs_its_price_for_each_share_of_its_limit() -> None:
    """Apart takes 126 ms of 100: 0.26 too much, at 2 for each 100 ms."""
    priced = robot(replace(SEE, price=2.0))
    result = plan.evaluate(priced, APART)
    assert result.feasible
    assert result.objective is not None
    assert result.objective.time == pytest.approx(0.52)
    free = plan.evaluate(robot(replace(SEE, limit=1.0)), APART).objective
    assert free is not None
    assert result.objective.total == pytest.approx(free.total + 0.52)
    (time,) = result.times
    assert (time.name, time.limit, time.price) == ("see", 0.1, 2.0)


def test_says_what_takes_too_long_and_most_of_it() -> None:
    assert plan.evaluate(robot(), APART).reason == (
        "time limit 'see': takes 126 ms, limit 100 ms "
        "(most of it: camera to finder on head and base, 106 ms)"
    )


def test_says_which_computer_would_take_too_long() -> None:
    said = plan.explain(robot(), BESIDE, "finder")
    assert isinstance(said, plan.Explanation)
    assert said.reason == "no other computer can take it"
    (base,) = (each for each in said.options if each.computer == "base")
    assert base.obstacle.startswith("time limit 'see': takes 126 ms, limit 100 ms")


def test_what_is_late_anyway_is_no_obstacle() -> None:
    """A third component has no part in what is late wherever it goes."""
    late = robot(replace(SEE, limit=0.02))
    late = replace(late, components=(*late.components, Item(name="other")))
    said = plan.explain(late, {**BESIDE, "other": "head"}, "other")
    assert isinstance(said, plan.Explanation)
    assert [each.obstacle for each in said.options] == ["", ""]


def test_time_is_among_what_speaks_against_a_computer() -> None:
    said = plan.explain(robot(replace(SEE, price=9.0)), BESIDE, "finder")
    assert isinstance(said, plan.Explanation)
    assert "(time +2.34)" in said.reason


def test_the_trace_of_the_greedy_says_what_is_too_late_already() -> None:
    late = robot(replace(SEE, limit=0.025))
    result = plan.solve(late, method="greedy")
    assert not result.feasible
    tried = result.trace[-1].trials
    assert [each.total for each in tried] == [None, None]
    assert "time limit 'see': takes" in tried[0].reason


def test_names_the_conflict_and_by_how_much_to_raise_the_limit() -> None:
    """Both need 1.1 cores of `head`, or 126 ms; 0.1 of 1 core is the smaller raise."""
    problem = robot()
    wide = replace(problem.components[1], demand={"cpu": 0.8})
    asked = replace(problem, components=(problem.components[0], wide))
    found = plan.solve(asked)
    assert found.proven
    assert found.conflict is not None
    assert found.conflict.components == ("camera", "finder")
    assert set(found.conflict.limits) == {
        "head has 1 cpu",
        "time limit 'see' is 100 ms",
        "camera may only run on head",
    }
    (raised,) = found.conflict.more
    assert (raised.on, raised.resource) == (("head",), "cpu")
    head = replace(asked.computers[0], capacity={"cpu": 0.31})
    said = plan.solve(replace(asked, computers=(head, asked.computers[1]))).conflict
    assert said is not None
    (raised,) = said.more
    assert (raised.on, raised.resource) == (("see",), "time")
    assert raised.amount == pytest.approx(0.026, rel=0.01)
    assert said.relaxation == "26 ms more for time limit 'see' (100 ms now)"


def test_what_pins_make_too_long_is_known_without_a_search() -> None:
    """Also where there are too many components for a proof."""
    problem = robot(replace(SEE, fixed=0.1))
    many = tuple(Item(name=f"c{i}", demand={"cpu": 1e-6}) for i in range(1100))
    asked = replace(problem, components=(*problem.components, *many))
    result = plan.solve(asked, 0.01)
    assert result.proven
    assert not result.feasible
    assert result.conflict is not None
    assert result.conflict.limits[0] == (
        "time limit 'see': takes at least 120 ms, limit 100 ms "
        "(most of it: camera on head, 10 ms)"
    )


def test_a_limit_without_one_of_its_components_is_dropped() -> None:
    problem = robot()
    assert plan.keep_components(problem, {"camera"}).time_limits == ()
    for changed in (
        plan.keep_components(problem, {"camera", "finder"}),
        plan.add(problem, Computer(name="arm")),
        plan.scale(problem, {"cpu": 2.0}),
        plan.share_cpu(problem),
    ):
        assert changed.time_limits == problem.time_limits


def test_only_the_chosen_alternative_has_to_be_in_time() -> None:
    """The good finder would be late on its only computer; the plain one is not."""
    good = Item(name="good", demand={"cpu": 0.5}, only=("base",))
    problem = robot()
    hop = Hop(between=("camera", "good"), seconds=0.2)
    asked = replace(
        problem,
        components=(*problem.components, good),
        architectures=(
            Bundle(name="quick", components=("finder",), function="find", quality=0.5),
            Bundle(name="exact", components=("good",), function="find"),
        ),
        time_limits=(SEE, TimeLimit(name="look", limit=0.1, hops=(hop,))),
    )
    result = plan.solve(asked)
    assert result.architectures == {"find": "quick"}
    assert [time.name for time in result.times] == ["see"]


def test_components_that_must_be_together_have_no_hop_between_them() -> None:
    joined = replace(robot(), together=(("camera", "finder"),))
    assert plan.solve(joined).times[0].seconds == pytest.approx(0.03)


def test_phases_are_in_time_together() -> None:
    """Each has the CPU to itself: 10 / (1 - 0.5) + 20 / (1 - 0.3) ms beside."""
    priced = robot(replace(SEE, shared=True, limit=0.1))
    phases = plan.TaskProblem(
        phases=(
            plan.PhaseProblem(name="one", problem=priced, after={"two": 1.0}),
            plan.PhaseProblem(name="two", problem=priced, after={"one": 1.0}),
        ),
        move={"finder": 0.1},
    )
    result = plan.solve_phases(phases, steps=2000)
    assert result.feasible
    for phase in result.results.values():
        assert phase.placement == BESIDE
        assert phase.times[0].seconds == pytest.approx(0.02 + 0.02 / 0.7)


def test_a_file_has_time_limits(tmp_path: Path) -> None:
    path = tmp_path / "problem.json"
    path.write_bytes(msgspec.json.encode(robot()))
    assert plan.load(path).time_limits == (SEE,)


def test_reports_all_that_is_wrong_with_time_limits() -> None:
    wrong = TimeLimit(
        name="see",
        limit=0.0,
        fixed=-1.0,
        runs=(Run(component="camra", seconds=nan),),
        hops=(
            Hop(between=("camera", "arm"), seconds=inf, crossings=-1.0, size=1e31),
            Hop(between=("camera",)),  # type: ignore[arg-type]
            Hop(between="camera"),  # type: ignore[arg-type]
        ),
        price=-2.0,
    )
    with pytest.raises(RobotError) as caught:
        robot(wrong)
    assert "is the text 'camera', must be names" in str(caught.value)
    with pytest.raises(RobotError) as caught:
        robot(time_limits=(SEE, replace(wrong, hops=wrong.hops[:2])))
    for expected in (
        "time limit 'see' is there 2 times",
        "time limit 'see': limit is 0, must be above 0",
        "time limit 'see': fixed is -1.0",
        "time limit 'see': price is -2.0",
        "time limit 'see': run of camra: seconds is nan",
        "time limit 'see': there is no component 'camra' (did you mean 'camera'?)",
        "time limit 'see': hop camera - arm: seconds is inf",
        "time limit 'see': hop camera - arm: crossings is -1",
        "time limit 'see': hop camera - arm: size is 1e+31",
        "time limit 'see': there is no component 'arm'",
        "time limit 'see': hop between camera: it must join two components",
    ):
        assert expected in str(caught.value)


def test_refuses_a_latency_that_is_none() -> None:
    link = Link(between=("head", "base"), latency=-0.1)
    with pytest.raises(RobotError, match=r"link head - base: latency is -0\.1"):
        robot(links=(link,))
