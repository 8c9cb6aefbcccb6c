"""Profiles a robot: measures each architecture alone and keeps the result."""

from __future__ import annotations

import contextlib
import datetime as dt
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

from poise.errors import RunError, UsageError
from poise.estimate.code_version import version_of
from poise.estimate.profiles import WINDOW, Profile
from poise.manage.agent_connections.statuses import components_of
from poise.manage.deploy.deactivation import drain
from poise.manage.journal import Journal
from poise.manage.observe.sample_recording import Recording
from poise.model.robot import Robot
from poise.session import Check, Say, log, nothing
from poise.session.arguments import check_duration, check_robot
from poise.session.last_seen import LastSeen
from poise.session.launch.start import Sampling, Started, started
from poise.session.profiling.figures import (
    Figures,
    Observed,
    disagreeing,
    failures,
    figures,
    how_full,
    measure,
)
from poise.session.profiling.rig import ProfilingRig, rig_of
from poise.session.profiling.stored_profiles import (
    check_keepable,
    loops,
    read_profile,
    steady,
    store_of,
    write_profile,
)
from poise.session.run_records import silent_ports
from poise.version import VERSION

Tick = Callable[[float], None]
Progress = Callable[[str, float], AbstractContextManager[Tick]]
"""Takes an architecture and the time that its measurement takes [s]; gives a function
that is called with the time that has passed [s]."""
_MOST_EXTRA = 2
"""How often unstable or invalid measurements are repeated."""
_FULL = 0.9
"""What uses more of a computer's CPU on average waits for it at times."""


class Profiling(Struct, frozen=True, kw_only=True):
    """The result of profiling.

    Parameters
    ----------
    profile
        The measurements, with those of an older profile for other components.
    file
        The file that was written; None: the robot file names none.
    silent
        Component -> its ports that got nothing during the measurement.
    unrecorded
        The components whose figures are discarded, because their inputs were silent,
        or something of them failed each time.
    """

    profile: Profile
    file: Path | None
    silent: Mapping[str, Sequence[str]]
    unrecorded: Sequence[str]


@contextlib.contextmanager
def _no_progress(_: str, __: float) -> Iterator[Tick]:
    yield lambda _: None


def profile(  # noqa: PLR0913 - each is a choice of the user
    robot: Robot,
    *,
    architectures: Sequence[str] = (),
    computer: str | None = None,
    seconds: float = 30.0,
    warm_up: float = 3.0,
    repeat: int = 2,
    say: Say = log.info,
    progress: Progress = _no_progress,
    check: Check = nothing,
) -> Profiling:
    """Measure what each component needs, every architecture alone on one computer.

    The result is written to the profile that the robot file names, and to the store.

    Parameters
    ----------
    architectures
        Names of those to measure; empty: all.
    computer
        The computer to measure on; None: the first.
    seconds, warm_up
        Duration of each measurement, and of the time before it [s].
    repeat
        How often to measure each architecture; at least 1.
    say
        Called with a sentence for each doubt about a measurement.
    progress
        Called for each architecture.
    check
        Called several times a second; may raise to end the measurement.

    Raises
    ------
    UsageError
        A name is unknown, or the result cannot be written.
    RobotError, RunError
        The robot could not be run.
    """
    check_robot(robot)
    check_duration("a measurement", seconds)
    names = _chosen(robot, architectures)
    check_keepable(robot)
    computer = computer or robot.hosts[0].name
    found = []
    with steady(robot):
        # what a core of the profile's machine does [loops/s]; 0: not known yet
        reference = 0.0
        if architectures and (old := _earlier(robot, computer)):
            reference = old.loops  # the new figures join those of others in it
        measuring = _Measuring(
            robot=robot,
            computer=computer,
            seconds=seconds,
            warm_up=warm_up,
            repeat=repeat,
            say=say,
            check=check,
        )
        for name in names:
            total = (repeat + 1) * (seconds + warm_up)
            with progress(name, total) as tick:
                found.append(measuring.measure(name, reference, tick))
            reference = reference or found[0].loops
    silent = {n: p for each in found for n, p in each.silent.items()}
    unrecorded = [name for each in found for name in each.unrecorded]
    new = measuring.profile([each.figures for each in found], unrecorded, reference)
    kept = _kept(robot, new)
    file = write_profile(robot, kept)
    return Profiling(profile=kept, file=file, silent=silent, unrecorded=unrecorded)


def _chosen(robot: Robot, names: Sequence[str]) -> list[str]:
    known = [a.name for a in robot.architectures]
    if not known:
        raise UsageError(f"robot '{robot.name}' has no architectures to measure")
    unknown = [name for name in names if name not in known]
    if unknown:
        raise UsageError(
            f"--architecture {', '.join(unknown)}: the robot has {', '.join(known)}"
        )
    return list(names) or known


class _Found(Struct, frozen=True):
    """Figures of an architecture, ports that got nothing, and who did not work so.

    `loops`: what a core did while it was measured [loops/s]; 0: of a real computer.
    """

    figures: Figures
    loops: float
    silent: Mapping[str, Sequence[str]]
    unrecorded: Sequence[str]


def _earlier(robot: Robot, computer: str) -> Profile | None:
    """Return the profile that new figures of this computer join, if there is one."""
    old = read_profile(robot)
    if old is None or (old.robot, old.computer) != (robot.name, computer):
        return None
    return old


class _Measuring(Struct, frozen=True, kw_only=True):
    """Measures architectures, one after the other."""

    robot: Robot
    computer: str
    seconds: float
    warm_up: float
    repeat: int
    say: Say
    check: Check

    def measure(self, architecture: str, reference: float, tick: Tick) -> _Found:
        """Measure one architecture: as it is used, and with its components apart.

        `reference`: what a core of the profile's machine does [loops/s]; 0: what one
        does here.
        """
        rig = rig_of(self.robot, architecture, self.computer, apart=False)
        apart = rig_of(self.robot, architecture, self.computer, apart=True)
        before = self._loops()
        runs = self._runs(rig, tick)
        here = (before + self._loops()) / 2
        speed = self._speed(here, reference)
        sizes = self._run(apart, tick)
        if (full := how_full(runs, rig)) >= _FULL:
            self.say(
                f"'{rig.computer}' was full ({full:.0%} of its CPU): timers and calls "
                "may have fallen behind, so CPU and rates may be too small: measure on "
                "a larger computer (--on), or with less else running"
            )
        if doubtful := ", ".join(disagreeing(runs, rig.measured)):
            why = (
                "one measurement, with jobs that were not done, or no figures"
                if len(runs) == 1
                else f"{len(runs)} measurements that differ, or had jobs that were not "
                "done"
            )
            self.say(f"not stable: {doubtful} ({why})")
        versions = {
            c.name: version_of(c, *self.robot.folders) for c in self.robot.components()
        }
        found = figures(self.robot, rig, runs, sizes, versions=versions, speed=speed)
        silent = self._silent(rig, [*runs, sizes])
        failed = failures(rig.robot, runs[-1], rig.measured)
        for sentence in failed.sentences:
            self.say(sentence)
        if failed.always:
            self.say(
                f"something failed each time: {', '.join(sorted(failed.always))}: the "
                "figures are discarded; `poise log` of a run says more"
            )
        idle = failed.always.union(self._idle(sizes, silent))
        return _Found(found, here, silent, sorted(idle))

    def _silent(
        self, rig: ProfilingRig, runs: Sequence[Observed]
    ) -> dict[str, list[str]]:
        """Return component -> its connected ports to which nothing came in any run."""
        ports = self._connected(rig.measured)
        for run in runs:
            silent = silent_ports(rig.robot, run.statuses, ports)
            ports &= {each.port for each in silent}
        return {
            name: sorted(p.partition(".")[2] for p in ports if p.startswith(f"{name}."))
            for name in rig.measured
            if any(port.startswith(f"{name}.") for port in ports)
        }

    def _connected(self, names: Collection[str]) -> set[str]:
        """Return the components' connected ports; a command has its own connections."""
        coded = {c.name for c in self.robot.components() if c.implementation}
        ends = (connector.between[1] for connector in self.robot.all_connectors())
        return {str(end) for end in ends if end.component in coded.intersection(names)}

    def _idle(self, run: Observed, silent: Mapping[str, Sequence[str]]) -> list[str]:
        """Return the components that did not do their work because of silent ports.

        They wait for messages of each subscribed port. Calls to provided ports may be
        rare, unless there is no other input.
        """
        topics = {c.name: c.subscribes for c in components_of(run.statuses)}
        return [
            name
            for name, ports in silent.items()
            if len(ports) == len(self._connected({name}))
            or not set(ports).isdisjoint(topics.get(name, ()))
        ]

    def profile(
        self, found: Sequence[Figures], unrecorded: Iterable[str], reference: float
    ) -> Profile:
        """Return the profile of the measured components without `unrecorded`."""
        components = {n: c for each in found for n, c in each.components.items()}
        return Profile(
            robot=self.robot.name,
            poise=VERSION,
            computer=self.computer,
            speed=self.robot.computer(self.computer).speed,
            at=dt.datetime.now(dt.UTC).isoformat(timespec="seconds"),
            seconds=self.seconds,
            loops=reference,
            agent=max(each.agent for each in found),
            components={n: c for n, c in components.items() if n not in unrecorded},
            connectors={n: c for each in found for n, c in each.connectors.items()},
        )

    def _runs(self, rig: ProfilingRig, tick: Tick) -> list[Observed]:
        runs: list[Observed] = []
        for attempt in range(self.repeat + _MOST_EXTRA):
            run = self._run(rig, tick)
            if not run.invalid or attempt == self.repeat + _MOST_EXTRA - 1:
                runs.append(run)
            if len(runs) >= self.repeat and not disagreeing(runs, rig.measured):
                break
        return runs

    def _run(self, rig: ProfilingRig, tick: Tick) -> Observed:
        run = measure_alone(rig, self.seconds, self.warm_up, tick, self.check)
        if run.invalid:
            self.say(run.invalid)
        return run

    def _loops(self) -> float:
        """Return what a core here does now [loops/s]: others may slow it down."""
        return loops() if self.robot.is_emulated else 0.0

    def _speed(self, here: float, reference: float) -> float:
        """Return the factor from the computer's CPU time to the reference computer's.

        An emulated computer of speed 0.5 runs half of the time, at full speed; its
        reference is a core of the machine of the profile, if there is one, and a core
        did `here` while it was measured.
        """
        if self.robot.is_emulated:
            return here / (reference or here)
        return self.robot.computer(self.computer).speed


def _kept(robot: Robot, new: Profile) -> Profile:
    """Return the new profile with older figures of others, and add it to the store."""
    merged = _merged(new, _earlier(robot, new.computer), robot)
    with store_of(robot) as store:
        if not merged.costs:
            costs = store.latest_costs(robot.name)
            merged = replace(merged, costs=costs)
        store.add(merged)
    return merged


def _merged(new: Profile, old: Profile | None, robot: Robot) -> Profile:
    """Return the new profile with the older one's figures of other components."""
    if old is None:
        return new
    names = {c.name for c in robot.components()}
    components = {n: c for n, c in old.components.items() if n in names}
    connectors = {str(c) for c in robot.all_connectors()}
    joined = {n: c for n, c in old.connectors.items() if n in connectors}
    return replace(
        new,
        components={**components, **new.components},
        connectors={**joined, **new.connectors},
        costs=old.costs,
    )


def measure_alone(
    rig: ProfilingRig,
    seconds: float,
    warm_up: float,
    tick: Tick,
    check: Check = nothing,
) -> Observed:
    """Return one measurement of a rig."""
    recording = Recording()
    sampling = Sampling(recording.add, WINDOW, weigh=True)
    journal = Journal(":memory:")
    try:
        with started(rig.robot, rig.placement, journal, nothing, sampling, check) as up:
            _watch(up, warm_up, tick)
            recording.drain()
            up.computers.begin({rig.computer: rig.promised})
            _watch(up, seconds, tick)
            samples = recording.drain()
            invalid = up.computers.end(rig.computer)
            working = up.live.agents.statuses()
            # a caller whose callee ends before it would fail
            drain(up.live, LastSeen().unprocessed)
            return Observed(
                measured=measure(samples, rig.robot),
                statuses=up.live.agents.statuses(),
                working=working,
                invalid=invalid,
            )
    finally:
        journal.close()


def _watch(up: Started, seconds: float, tick: Tick) -> None:
    if up.watch(seconds, tick):
        raise RunError(
            "the simulator ended during the measurement: name an endless one as "
            "`workload` in the robot file, or measure for a shorter time"
        )
