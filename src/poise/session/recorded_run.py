"""A recording of a run: as a table, as estimates, and what policies would have done."""

from __future__ import annotations

import csv
import itertools
from collections.abc import Iterable, Iterator, Mapping
from operator import attrgetter
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from msgspec import Struct

from poise.errors import UsageError
from poise.manage.adaptation.policies import Policies
from poise.manage.observe.estimates import DemandEstimate, Estimates
from poise.model.policy import Do, Seen, Values, policies_of
from poise.model.robot import Robot
from poise.session import Say, log
from poise.session.arguments import check_path, check_robot
from poise.session.profiling.stored_profiles import read_profile
from poise.wire.recording_file import (
    SEEN,
    check_recorded,
    messages_of,
    robot_of,
    samples_of,
)
from poise.wire.records.status_records import (
    AgentSample,
    ComponentSample,
    ConnectorSample,
    ContainerSample,
)

Which = Literal["components", "connectors"]
Value = str | int | float

COLUMNS: dict[Which, dict[str, str]] = {
    "components": {
        "computer": "agent.computer",
        "container": "container.name",
        "component": "entry.name",
        "epoch": "entry.epoch",
        "at_s": "container.at",
        "cpu_s": "entry.cpu",
        "wait_s": "entry.wait",
        "asked": "entry.asked",
        "done": "entry.done",
        "container_cpu_s": "container.cpu",
        "container_memory_bytes": "container.memory",
    },
    "connectors": {
        "computer": "agent.computer",
        "container": "container.name",
        "connector": "entry.name",
        "at_s": "container.at",
        "calls": "entry.calls",
        "messages": "entry.messages",
        "bytes_out": "entry.bytes_out",
        "bytes_in": "entry.bytes_in",
        "errors": "entry.errors",
        "drops": "entry.drops",
        "arrivals": "entry.arrivals",
        "latency_s": "entry.latency",
        "latency_error_s": "entry.latency_error",
    },
}
"""Of each table: column -> where its value is in a sample; counters are totals since
the component or connector began."""
_MANY = 10_000
"""Rows that are turned into columns at a time."""


class _Row(NamedTuple):
    agent: AgentSample
    container: ContainerSample
    entry: ComponentSample | ConnectorSample


def rows(samples: Iterable[AgentSample], which: Which) -> Iterator[dict[str, Value]]:
    """Yield a row for every component, or end of a connector, in every sample."""
    columns = COLUMNS[which]
    values = attrgetter(*columns.values())
    for sample in samples:
        for container in sample.containers:
            for entry in getattr(container, which):
                row = _Row(sample, container, entry)
                yield dict(zip(columns, values(row), strict=True))


def export(samples: Iterable[AgentSample], path: Path, which: Which) -> int:
    """Write a table to a file whose name ends in .csv or .parquet; return its rows."""
    writers = {".csv": _write_csv, ".parquet": _write_parquet}
    if path.suffix not in writers:
        raise UsageError(
            f"{path}: the name says the format, and ends in {' or '.join(writers)}"
        )
    return writers[path.suffix](rows(samples, which), path, COLUMNS[which])


def _write_csv(
    found: Iterable[dict[str, Value]], path: Path, columns: Iterable[str]
) -> int:
    count = 0
    with path.open("w", newline="", encoding="utf-8") as file:
        out = csv.DictWriter(file, list(columns), lineterminator="\n")
        out.writeheader()
        for count, row in enumerate(found, 1):  # noqa: B007, the last is returned
            out.writerow(row)
    return count


def _write_parquet(
    found: Iterator[dict[str, Value]], path: Path, columns: Iterable[str]
) -> int:
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError as error:
        raise UsageError(
            f"{path}: Parquet needs pyarrow: pip install 'poise[parquet]'"
        ) from error
    schema = pa.schema([(name, _type(pa, name)) for name in columns])
    count = 0
    with parquet.ParquetWriter(path, schema) as writer:
        while group := list(itertools.islice(found, _MANY)):
            writer.write_table(pa.Table.from_pylist(group, schema=schema))
            count += len(group)
    return count


def _type(pa: Any, column: str) -> Any:  # noqa: ANN401, of a library without types
    if column in ("computer", "container", "component", "connector"):
        return pa.string()
    return pa.float64() if column.endswith("_s") else pa.int64()


if TYPE_CHECKING:
    import pandas as pd


class RecordedRun:
    """What agents said of a run, several times a second.

    Parameters
    ----------
    file
        What `poise.run` or `poise.up` wrote with ``record=...``.

    Raises
    ------
    UsageError
        The file cannot be read, or is no recording. Every method: it has no samples,
        since `poise.record` wrote it.
    """

    def __init__(self, file: str | PathLike[str]) -> None:
        check_path("file", file)
        self.file = Path(file)
        self.robot = robot_of(self.file)

    def rows(self, of: Which = "components") -> list[dict[str, Any]]:
        """Return a row for every component, or end of a connector, in every sample."""
        return list(rows(self._samples(), of))

    def to_pandas(self, of: Which = "components") -> pd.DataFrame:
        """Return `rows` as a data frame; pandas must be installed."""
        import pandas as pd

        return pd.DataFrame(self.rows(of))

    def export(self, to: str | PathLike[str], of: Which = "components") -> int:
        """Write `rows` to a .csv or .parquet file; return how many there are."""
        return export(self._samples(), Path(to), of)

    def cores(self, robot: Robot) -> dict[str, tuple[float, ...]]:
        """Return component -> CPU that it used in each second [cores of the reference].

        A second in which it was nowhere, or of which too little is known, is as the one
        before.

        Raises
        ------
        UsageError
            Another robot was recorded.
        """
        check_recorded(self.file, robot.name)
        speeds = {
            c.name: 1.0 if robot.is_emulated else c.speed for c in robot.computers
        }
        samples = sorted(self._samples(), key=lambda each: each.at)
        began = {each.computer: each.at for each in reversed(samples)}
        used: dict[str, dict[int, float]] = {}
        before: dict[tuple[str, int, int], float] = {}
        for sample in samples:
            second = int(sample.at - began[sample.computer])
            for container in sample.containers:
                for component in container.components:
                    key = component.name, component.epoch, container.pid
                    cpu = (component.cpu - before.get(key, component.cpu)) * speeds.get(
                        sample.computer, 1.0
                    )
                    before[key] = component.cpu
                    seconds = used.setdefault(component.name, {})
                    seconds[second] = seconds.get(second, 0.0) + max(0.0, cpu)
        return {name: _each_second(seconds) for name, seconds in sorted(used.items())}

    def replay(self, robot: Robot, *, say: Say = log.info) -> list[DemandEstimate]:
        """Return what the robot's components needed at the end, by their estimates.

        Parameters
        ----------
        robot
            The robot that was recorded.
        say
            Takes a sentence each time a demand shifts.

        Raises
        ------
        UsageError
            Another robot was recorded.
        """
        check_recorded(self.file, robot.name)
        estimates = Estimates(robot, read_profile(robot), emulated=robot.is_emulated)
        samples = sorted(self._samples(), key=lambda each: each.at)
        for sample in samples:
            for name, drift in estimates.add(sample):
                needs = f"{drift.after:.1%} of a core, {drift.before:.1%} before"
                at = sample.at - samples[0].at
                say(f"{at:.1f} s: '{name}' needs {needs}")
        return estimates.demand_estimates()

    def _samples(self) -> Iterator[AgentSample]:
        samples = samples_of(self.file)
        first = next(samples, None)
        if first is None:
            raise UsageError(
                f"nothing that components use is recorded in {self.file}: `poise run "
                "--record` and `poise up --record` record it"
            )
        return itertools.chain([first], samples)


def _each_second(used: Mapping[int, float]) -> tuple[float, ...]:
    """Return what was used in each whole second, without the last one."""
    found: list[float] = []
    for second in range(max(used)):
        found.append(used.get(second, found[-1] if found else 0.0))
    return tuple(found)


class PolicyEvent(Struct, frozen=True, kw_only=True):
    """Something that a policy would have done.

    Parameters
    ----------
    at
        When [s], since the recording began.
    policy, do
        The policy's name, and its action.
    about, computer
        The subject, and where it was.
    what
        A sentence for people.
    saw
        The values of the subject.
    """

    at: float
    policy: str
    do: Do | None
    about: str
    computer: str
    what: str
    saw: Values


def test_policies(
    robot: Robot,
    recording: str | PathLike[str],
    *,
    say: Say = log.info,  # noqa: PT028, it is no test
) -> tuple[PolicyEvent, ...]:
    """Return what the policies of a robot would have done, without acting.

    It replays the values that were seen, so what an action would have changed does not
    show: a policy acts again after each cool-down while its condition holds. Whether a
    new placement would have been worth its moves is not computed.

    Parameters
    ----------
    recording
        A file of `poise up --record`.
    say
        Takes what is wrong with policies' own functions.

    Raises
    ------
    UsageError
        It cannot be read, another robot was recorded, or nothing that policies see.
    """
    check_robot(robot)
    check_path("recording", recording)
    check_recorded(Path(recording), robot.name)
    names = (component.name for component in robot.components())
    policies = Policies(policies_of(robot.policies), robot.folder, names)
    found: list[PolicyEvent] = []
    began: float | None = None
    troubles: set[str] = set()
    try:
        for seen in messages_of(Path(recording), SEEN, Seen):
            began = seen.at if began is None else began
            due = policies.due(policies.evaluate(seen.of, seen.at, waits=True), seen.at)
            policies.note_acted(due, seen.at)
            for trouble in set(policies.troubles().values()) - troubles:
                say(trouble)
                troubles.add(trouble)
            found += [
                PolicyEvent(
                    at=seen.at - began,
                    policy=symptom.policy.name,
                    do=symptom.policy.do,
                    about=symptom.values.name,  # noqa: PD011, no data frame
                    computer=symptom.computer,
                    what=symptom.what,
                    saw=symptom.values,
                )
                for symptom in due
            ]
    finally:
        policies.close()
    if began is None:
        raise UsageError(
            f"nothing that policies see is recorded in {recording}: "
            "`poise up --record` records it"
        )
    return tuple(found)


test_policies.__test__ = False  # type: ignore[attr-defined] # no test, if pytest sees it
