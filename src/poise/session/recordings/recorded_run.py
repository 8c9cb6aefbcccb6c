"""A recording of a run: as a table, or as estimates of what components needed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from poise.errors import UsageError
from poise.manage.observe.estimates import DemandEstimate, Estimates
from poise.model.robot import Robot
from poise.session.callbacks import Say, log
from poise.session.profiling.stored_profiles import read_profile
from poise.session.recordings.export import Which, export, rows
from poise.wire.recording_file import parts_of
from poise.wire.records.samples import AgentSample

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
        The file cannot be read, or is no recording.
    """

    def __init__(self, file: str | PathLike[str]) -> None:
        self.file = Path(file)
        self._robot = next(parts_of(self.file)).robot

    @property
    def robot(self) -> str:
        """The robot's name."""
        return self._robot

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
        self._check_robot(robot)
        emulated = all(computer.address is None for computer in robot.computers)
        speeds = {c.name: 1.0 if emulated else c.speed for c in robot.computers}
        samples = sorted(self._samples(), key=lambda each: each.at)
        began = {each.computer: each.at for each in reversed(samples)}
        used: dict[str, dict[int, float]] = {}
        before: dict[tuple[str, int, int], float] = {}
        for sample in samples:
            second = int(sample.at - began[sample.computer])
            for container in sample.containers:
                for each in container.components:
                    key = each.name, each.epoch, container.pid
                    cpu = (each.cpu - before.get(key, each.cpu)) * speeds.get(
                        sample.computer, 1.0
                    )
                    before[key] = each.cpu
                    seconds = used.setdefault(each.name, {})
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
        self._check_robot(robot)
        emulated = all(computer.address is None for computer in robot.computers)
        estimates = Estimates(robot, read_profile(robot), emulated=emulated)
        samples = list(self._samples())
        began = min((sample.at for sample in samples), default=0.0)

        for sample in sorted(samples, key=lambda each: each.at):
            for name, drift in estimates.take(sample):
                say(
                    f"{sample.at - began:.1f} s: '{name}' needs {drift.after:.1%} "
                    f"of a core, {drift.before:.1%} before"
                )
        return estimates.demand_estimates()

    def _check_robot(self, robot: Robot) -> None:
        if robot.name != self.robot:
            raise UsageError(
                f"{self.file} was recorded of robot '{self.robot}', not of "
                f"'{robot.name}'"
            )

    def _samples(self) -> Iterator[AgentSample]:
        for part in parts_of(self.file):
            yield from part.samples


def _each_second(used: Mapping[int, float]) -> tuple[float, ...]:
    """Return what was used in each whole second, without the last one."""
    found: list[float] = []
    for second in range(max(used)):
        found.append(used.get(second, found[-1] if found else 0.0))
    return tuple(found)
