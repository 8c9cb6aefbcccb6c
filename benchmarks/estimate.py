"""How well Poise knows what components need: ``python -m benchmarks.estimate``.

Four questions, each with the goal that `GOALS` gives:

- Is the profile right? Components whose CPU is known run alone and 24 together, half
  of them in calls from others; the largest error of any of them, in cores. Six of
  them run apart, as `poise profile` has them do: memory that they hold, what they send
  (not with ``--quick``).
- Is the prediction right? T-Rot is placed and run; what each computer used against
  what the profile says that it would use.
- Is drift found, and nothing else? Time until a component that begins to use half as
  much again is told of; how often a drift was told that was none.
- What does it cost? CPU of the agent and of the manager with 100 components that are
  sampled at 5 Hz, against the same without, and of the counting in the components'
  threads; as a share of a core.

It imports internal modules: it compares single samples and estimates with the truth.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import msgspec

from benchmarks.synthetic import robots
from benchmarks.synthetic.workers import RATE
from poise.estimate.demands import kinds_together, overhead_of
from poise.estimate.profiles import Profile
from poise.manage.journal import Journal
from poise.manage.observe.estimates import Estimates
from poise.manage.observe.sample_recording import Recording
from poise.model.robot import Robot
from poise.runtime._calls import ComponentCounters
from poise.session.launch.start import Sampling, started
from poise.session.placing.placement import place
from poise.session.profiling.figures import figures, measure
from poise.session.profiling.profile_robot import measure_alone
from poise.session.profiling.rig import rig_of
from poise.session.profiling.stored_profiles import read_profile
from poise.session.robot_file import load
from poise.wire.records.status_records import SAMPLE_EVERY, AgentSample, AgentStatus

TROT = Path(__file__).parents[1] / "examples" / "trot" / "robot.yaml"
GOALS = {
    "worst_cpu_error": "5 % of the truth or 0.01 cores, whichever is larger",
    "worst_memory_error": "5 % of the truth or 1 % of the computer's, 10 MiB [bytes]",
    "worst_traffic_error": 0.05,
    "prediction_error": 0.05,
    "drift_found_s": 3.0,
    "false_alarms": 0,
    "overhead_share": 0.01,
}
LIGHT = 100
WARM_UP = 1.0
STEADY = 6.0
"""A component that is to drift is steady for so long [s]; 5 s of them teach it."""
AFTER = 3.5
"""So long it is watched then [s]."""


class Lengths(msgspec.Struct, frozen=True):
    """How long to run, and how many components alone."""

    alone: tuple[float, ...]
    seconds: float
    trot: float
    overhead: float
    steady: float


QUICK = Lengths((0.05, 0.9), 2.5, 10.0, 3.0, 0.0)
FULL = Lengths((0.05, 0.1, 0.2, 0.4, 0.6, 0.9), 15.0, 40.0, 30.0, 600.0)


class Ran(msgspec.Struct, frozen=True):
    """What a run left.

    Its samples, what computers used [cores], what their agents and the manager used
    themselves [cores], and what was told.
    """

    samples: list[AgentSample]
    cores: Mapping[str, float]
    agents_share: float
    manager: float
    told: Mapping[str, float]
    void: str


def run(
    robot: Robot,
    placement: Mapping[str, str],
    seconds: float,
    *,
    every: float = SAMPLE_EVERY,
    take: Callable[[AgentSample], object] | None = None,
) -> Ran:
    """Run components and return what they used, after a warm-up.

    Parameters
    ----------
    take
        Takes the samples; None: they are kept.
    """
    recording, journal = Recording(), Journal(":memory:")
    sampling = Sampling(take or recording.add, every)
    try:
        with started(robot, placement, journal, _silent, sampling) as up:
            up.live.watch(WARM_UP)
            recording.drain()
            up.computers.begin()
            begin, manager = up.live.agents.statuses(), time.process_time()
            end_at = time.monotonic() + seconds
            while (left := end_at - time.monotonic()) > 0:
                up.live.watch(min(left, 0.2))
                up.computers.poll()
            end, manager = up.live.agents.statuses(), time.process_time() - manager
            void = up.computers.end()
    finally:
        journal.close()
    told = {
        component.name: component.measures["dearer"].maximum
        for status in end.values()
        for container in status.containers
        for component in container.components
        if "dearer" in component.measures
    }
    cores, agents_share = {}, 0.0
    for name, last in end.items():
        lasted = last.uptime - begin[name].uptime
        cores[name] = (last.cpu - begin[name].cpu) / lasted
        agents_share += (own_cpu(last) - own_cpu(begin[name])) / lasted
    return Ran(recording.drain(), cores, agents_share, manager / seconds, told, void)


def own_cpu(status: AgentStatus) -> float:
    """Return the CPU time of an agent without its containers [s]."""
    return status.cpu - sum(container.cpu for container in status.containers)


def on_bench(robot: Robot) -> dict[str, str]:
    return {c.name: robot.computers[0].name for c in robot.components()}


def cpu_errors(robot: Robot, ran: Ran) -> dict[str, float]:
    """Return component -> measured mean less the truth [cores]."""
    measured = measure(ran.samples, robot).cpu
    return {n: measured[n].mean - truth for n, truth in robots.truths(robot).items()}


def within(errors: Mapping[str, float], truths: Mapping[str, float]) -> bool:
    return all(abs(e) <= max(0.05 * truths[n], 0.01) for n, e in errors.items())


def profiles(lengths: Lengths) -> dict[str, object]:
    """Measure components whose CPU is known."""
    errors: dict[str, float] = {}
    right, void = True, []
    for cpu in lengths.alone:
        robot = robots.alone(cpu)
        ran = run(robot, on_bench(robot), lengths.seconds, every=0.1)
        found = cpu_errors(robot, ran)
        right &= within(found, robots.truths(robot))
        errors[f"alone_{cpu:g}"] = found["worker"]
        void.append(ran.void)
    robot = robots.together()
    ran = run(robot, on_bench(robot), lengths.seconds, every=0.1)
    found = cpu_errors(robot, ran)
    right &= within(found, robots.truths(robot))
    void.append(ran.void)
    worst = max(found, key=lambda name: abs(found[name]))
    errors[f"together_{worst}"] = found[worst]
    return {
        "worst_cpu_error": max(map(abs, errors.values())),
        "cpu_within_goal": right,
        "cpu_errors": errors,
        "void": [sentence for sentence in void if sentence],
    }


def needs(lengths: Lengths) -> dict[str, object]:
    """Profile six components apart; their memory and traffic are known."""
    robot = robots.together()
    name, computer = robot.architectures[0].name, robot.computers[0].name
    rig = rig_of(robot, name, computer, apart=True)
    seen = measure_alone(rig, lengths.seconds, WARM_UP, lambda _: None)
    versions = dict.fromkeys(rig.measured, "")
    found = figures(robot, rig, [seen], seen, versions=versions, speed=1.0)
    memory = {
        name: found.components[name].memory - truth
        for name, truth in robots.held(robot).items()
        if name in found.components
    }
    rates = {n: c.rate / RATE - 1 for n, c in found.connectors.items()}
    sizes = {
        n: found.connectors[n].size / truth - 1
        for n, truth in robots.sizes(robot).items()
        if n in found.connectors
    }
    return {
        "worst_memory_error": max(map(abs, memory.values())),
        "worst_traffic_error": max(map(abs, [*rates.values(), *sizes.values()])),
        "memory_errors": memory,
        "rate_errors": rates,
        "size_errors": sizes,
    }


def predicted_cpu(
    robot: Robot, placement: Mapping[str, str], profile: Profile
) -> dict[str, float]:
    """Return the predicted CPU of each computer [cores of the reference computer].

    It is the sum of its components' means, their parts of containers, its agent, and
    the additional CPU of connectors to other computers.

    Parameters
    ----------
    placement
        Component -> computer; components without a profile count as 0.
    """
    used = {computer.name: profile.agent for computer in robot.computers}
    for component, computer in placement.items():
        known = profile.components.get(component)
        if known is not None:
            used[computer] += known.cpu.mean + known.share
    kinds = kinds_together(robot)
    for connector in robot.all_connectors():
        source, target = (placement.get(end.component) for end in connector.between)
        traffic = profile.connectors.get(str(connector))
        calibrated = "remote" in profile.costs
        if calibrated and traffic and source and target and source != target:
            # Only the sum of both ends of a direct connector can be measured: it is
            # divided in the ratio of a remote connector's ends.
            more = overhead_of(traffic, kinds[str(connector)], profile.costs) / 100
            remote = profile.costs["remote"]
            load = remote.load(traffic)
            at_source = more * remote.source.load(traffic) / load if load else 0.0
            used[source] += at_source
            used[target] += more - at_source
    return used


def predictions(lengths: Lengths) -> dict[str, object]:
    """Run T-Rot where Poise puts it, and compare with what its profile predicts."""
    robot = load(TROT, say=_silent)
    profile = read_profile(robot)
    if profile is None:
        sys.exit(f"{TROT} has no profile: `poise profile {TROT}` makes it")
    placement = place(robot, "serve").where
    ran = run(robot, placement, lengths.trot)
    predicted = predicted_cpu(robot, placement, profile)
    errors = {n: predicted[n] / ran.cores[n] - 1 for n in predicted}
    estimates = Estimates(robot, profile, emulated=True)
    alarms = [told for s in ran.samples for told in estimates.add(s)]
    return {
        "prediction_error": max(map(abs, errors.values())),
        "prediction_errors": errors,
        "measured_cores": ran.cores,
        "trot_alarms": {name: msgspec.to_builtins(drift) for name, drift in alarms},
        "trot_void": ran.void,
    }


def drifts(lengths: Lengths) -> dict[str, object]:
    """Let a component become dearer; a full run also watches 24 for ten minutes."""
    robot = robots.alone(0.2, STEADY)
    ran = run(robot, on_bench(robot), STEADY + AFTER)
    estimates = Estimates(robot, None, emulated=True)
    told = [drift.at for s in ran.samples for _, drift in estimates.add(s)]
    changed = ran.told["worker"]
    found = [at - changed for at in told if at >= changed]
    false = len([at for at in told if at < changed])
    watched, alarms = STEADY, []
    if lengths.steady:
        # a quarter of the load: the noise is the larger, and the machine not only ours
        robot = robots.together(0.25)
        steady = run(robot, on_bench(robot), lengths.steady)
        estimates = Estimates(robot, None, emulated=True)
        alarms = [each for s in steady.samples for each in estimates.add(s)]
        false += len(alarms)
        watched = lengths.steady
    return {
        "drift_found_s": min(found, default=None),
        "false_alarms": false,
        "alarms": {name: msgspec.to_builtins(drift) for name, drift in alarms},
        "steady_s": watched,
    }


def overhead(lengths: Lengths) -> dict[str, object]:
    """Compare 100 components that do next to nothing, with sampling and without."""
    robot = robots.light(LIGHT)
    placement = on_bench(robot)
    estimates = Estimates(robot, None, emulated=True)
    without = run(robot, placement, lengths.overhead, every=0)
    ran = run(robot, placement, lengths.overhead, take=estimates.add)
    agents_share = ran.agents_share - without.agents_share
    manager = ran.manager - without.manager
    counting = LIGHT * robots.LIGHT_RATE * counting_seconds()
    return {
        "overhead_share": agents_share + manager + counting,
        "overhead_agent": agents_share,
        "overhead_manager": manager,
        "overhead_counting": counting,
        "all_of_the_agent_and_containers": ran.cores["bench"],
    }


def counting_seconds() -> float:
    """Return what a component's thread counts for each of its jobs [s]."""
    account = ComponentCounters()
    account.begin()
    best = math.inf
    for _ in range(50):
        began = time.thread_time()
        for _ in range(100):
            account.note_asked()
            account.note_done()
            account.note_idle()
            account.note_busy()
        best = min(best, (time.thread_time() - began) / 100)
    return best


PARTS: dict[str, Callable[[Lengths], dict[str, object]]] = {
    "profile": profiles,
    "needs": needs,
    "prediction": predictions,
    "drift": drifts,
    "overhead": overhead,
}


def _silent(_: str) -> None:
    """Say nothing."""


def main() -> None:
    """Measure all, and print it."""
    parser = argparse.ArgumentParser(
        "python -m benchmarks.estimate", description=__doc__
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--quick", action="store_true", help="under a minute")
    parser.add_argument("--steady", type=float, help="steady load for so long [s]")
    parser.add_argument("--only", choices=PARTS, help="one of the questions")
    options = parser.parse_args()
    lengths = QUICK if options.quick else FULL
    if options.steady is not None:
        lengths = msgspec.structs.replace(lengths, steady=options.steady)
    # the components' module is imported from the benchmarks' folder
    sys.path.insert(0, robots.FOLDER)
    parts = [options.only] if options.only else [*PARTS]
    if options.quick and not options.only:
        parts.remove("needs")
    found: dict[str, object] = {}
    for part in parts:
        found |= PARTS[part](lengths)
    found["goals"] = GOALS
    found["cpus"] = os.cpu_count()
    if options.json:
        print(json.dumps(found, indent=2))
        return
    for name, value in found.items():
        print(f"{name:34} {value}")


if __name__ == "__main__":
    main()
