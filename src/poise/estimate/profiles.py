"""The records of a profile: measurements of components and connectors.

A profile belongs to one robot, one kind of computer and one version of the code. CPU is
in cores of the reference computer.
"""

from __future__ import annotations

import contextlib
import math
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Self, TypeVar

import msgspec
import yaml
from msgspec import Struct, structs

from poise.decoding import convert, from_json
from poise.errors import RobotError, UsageError, why_too_old

AnyRecord = TypeVar("AnyRecord", bound=Struct)


class SqliteFile:
    """Tables in a file; the file and its folder are created if missing."""

    def __init__(self, path: Path, schema: str, holds: str) -> None:
        self._path = path
        self._holds = holds
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._database = sqlite3.connect(path, isolation_level=None, timeout=1.0)
        except OSError as error:
            why = f"{error.filename}: {error.strerror}"
            raise UsageError(f"{path} cannot store {holds}: {why}") from error
        except sqlite3.Error as error:
            raise self._broken(error) from error
        try:
            self.execute(schema)
        except UsageError:
            self._database.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        self._database.close()
        # rows are read and decoded as they are used
        if isinstance(error, sqlite3.Error | msgspec.MsgspecError):
            raise self._broken(error) from error

    def execute(self, statement: str, *values: str | float) -> sqlite3.Cursor:
        """Carry a statement out; UsageError when that fails."""
        try:
            return self._database.execute(statement, values)
        except sqlite3.Error as error:
            raise self._broken(error) from error

    def _broken(self, error: Exception) -> UsageError:
        return UsageError(
            f"{self._path} cannot store {self._holds}: {error}. If it is damaged, or "
            "another version of Poise wrote it, remove it: its content is lost then"
        )


WINDOW = 0.1
"""CPU is measured over windows of this length [s]."""
SUSTAINED = 2.0
"""[s] A computer must provide the demand over windows of this length. Shorter bursts of
components on one computer rarely coincide."""
BATCHES = 10
# Student's t for a two-sided 95 % interval and 1, 2, ... degrees of freedom
_T95 = (12.71, 4.30, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26)


class Distribution(Struct, frozen=True, kw_only=True):
    """A measurement over windows of `WINDOW`, in its own unit (cores, for CPU).

    Parameters
    ----------
    sustained
        The 95th percentile over windows of `SUSTAINED`.
    error
        Half the width of the mean's 95 % confidence interval; None for too few windows.
    windows
        How many there were.
    """

    mean: float = 0.0
    p95: float = 0.0
    p99: float = 0.0
    peak: float = 0.0
    sustained: float = 0.0
    error: float | None = None
    windows: int = 0


def quantile(values: Sequence[float], share: float) -> float:
    """Return the smallest value that at least `share` (0 to 1) do not exceed."""
    ordered = sorted(values)
    # share * n of 0.95 * 20 is 19.000000000000004 in floating point
    rank = math.ceil(share * len(ordered) - 1e-9)
    return ordered[max(rank, 1) - 1]


def error_of_mean(values: Sequence[float]) -> float | None:
    """Return half the width of the 95 % confidence interval of a series' mean.

    Neighbouring windows are correlated, so the series is cut into `BATCHES` batches,
    whose means are nearly independent (method of batch means). None for fewer than four
    values.
    """
    num = min(BATCHES, len(values) // 2)
    if num <= 1:
        return None
    size = len(values) // num
    means = [sum(values[i * size : (i + 1) * size]) / size for i in range(num)]
    centre = sum(means) / num
    variance = sum([(mean - centre) ** 2 for mean in means]) / (num - 1)
    return _T95[num - 2] * math.sqrt(variance / num)


def distribution_of(values: Sequence[float], window: float = WINDOW) -> Distribution:
    """Return the distribution of a series over windows of `window` [s]."""
    if not values:
        return Distribution()
    return Distribution(
        mean=sum(values) / len(values),
        p95=quantile(values, 0.95),
        p99=quantile(values, 0.99),
        peak=max(values),
        sustained=quantile(rolling_means(values, round(SUSTAINED / window)), 0.95),
        error=error_of_mean(values),
        windows=len(values),
    )


def scaled(distribution: Distribution, factor: float) -> Distribution:
    """Return a distribution whose values are all `factor` times as large."""
    numbers = "mean", "p95", "p99", "peak", "sustained", "error"
    return _multiplied(distribution, factor, numbers)


def _multiplied(record: AnyRecord, factor: float, numbers: Iterable[str]) -> AnyRecord:
    """Return a record of which some numbers are multiplied; None stays."""
    values = {name: getattr(record, name) for name in numbers}
    return structs.replace(record, **{n: v and v * factor for n, v in values.items()})


def rolling_means(values: Sequence[float], size: int) -> list[float]:
    """Return the mean of every `size` values in a row; of all when there are fewer."""
    size = max(1, min(size, len(values)))
    total = sum(values[:size])
    means = [total / size]
    for last, first in zip(values[size:], values, strict=False):
        total += last - first
        means.append(total / size)
    return means


class TimerProfile(Struct, frozen=True, kw_only=True):
    """A timer's execution time [s], and the share of its deadlines that it missed.

    `missed`: None: it has no deadline.
    """

    period: float
    median: float
    p99: float
    maximum: float
    missed: float | None = None


_RARELY = 0.005
"""If a smaller share of its runs waits, a handler does not wait."""


class HandlerProfile(Struct, frozen=True, kw_only=True):
    """What the runs of a timer take, those for the messages of a port, or calls [s].

    Parameters
    ----------
    mean, median, p99
        Their CPU time, without that of what they call.
    waiting
        The share of them that waits for something else than CPU and calls, such as a
        device; None: it was not measured.
    wait, wait_p99
        For how long these do: the median, and the 99th percentile.
    """

    mean: float
    median: float
    p99: float
    waiting: float | None = None
    wait: float = 0.0
    wait_p99: float = 0.0

    @property
    def waits(self) -> bool:
        """Whether enough of them wait to count."""
        return (self.waiting or 0.0) >= _RARELY


class ComponentProfile(Struct, frozen=True, kw_only=True):
    """Measurements of a component whose architecture ran alone.

    Parameters
    ----------
    version
        Fingerprint of its implementation and parameters (`version_of`).
    cpu
        Its own CPU [cores].
    share
        Its part of the container's own CPU: threads and processes that it started,
        transports, status, the interpreter's threads [cores].
    memory
        Peak of the memory that it adds to a container [bytes].
    base
        Its equal part of an empty container's memory [bytes].
    state
        Size of its snapshot [bytes].
    start
        Time from the request to start its container until it is ready [s].
    handlers
        Timer or port -> what its runs take, of the reference computer.
    repeat
        Largest difference between the means of repeated measurements [cores].
    stable
        Whether repeated measurements agree.
    """

    version: str
    cpu: Distribution
    share: float = 0.0
    memory: float = 0.0
    base: float = 0.0
    state: float = 0.0
    start: float = 0.0
    timers: Mapping[str, TimerProfile] = {}
    handlers: Mapping[str, HandlerProfile] = {}
    repeat: float = 0.0
    stable: bool = True


class ConnectorProfile(Struct, frozen=True, kw_only=True):
    """Traffic of a connector.

    Parameters
    ----------
    calls, messages
        Per second [1/s].
    size
        Mean size of a call, both ways, or of a message, when encoded [bytes].
    median, p99, largest
        Of these sizes; 0 where they were not counted [bytes].
    answering
        What a call takes where it ends; None: it was not measured.
    """

    calls: float = 0.0
    messages: float = 0.0
    size: float = 0.0
    median: float = 0.0
    p99: float = 0.0
    largest: float = 0.0
    answering: HandlerProfile | None = None

    @property
    def rate(self) -> float:
        """Calls and messages per second [1/s]."""
        return self.calls + self.messages

    @property
    def traffic(self) -> float:
        """Its traffic when its ends are apart [bytes/s]."""
        return self.rate * self.size


class Costs(Struct, frozen=True, kw_only=True):
    """CPU time that one end of a connector costs its computer.

    `call` and `message` in CPU time each [s], `byte` in CPU time per byte [s/byte].
    """

    call: float = 0.0
    message: float = 0.0
    byte: float = 0.0

    def load(self, connector: ConnectorProfile) -> float:
        """Return the CPU of this end for a connector's traffic [cores]."""
        return (
            self.call * connector.calls
            + self.message * connector.messages
            + self.byte * connector.traffic
        )


class KindCosts(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Costs of connectors of one kind, at the source and at the target.

    Both ends of a direct connector are in one process: all counts for its source.
    """

    source: Costs = Costs()
    target: Costs = Costs()

    def load(self, connector: ConnectorProfile) -> float:
        """Return the CPU of both ends [cores]."""
        return self.source.load(connector) + self.target.load(connector)


class Profile(Struct, frozen=True, kw_only=True):
    """Measurements of a robot's software on one kind of computer.

    Parameters
    ----------
    poise
        The version of Poise.
    computer
        The computer on which it was measured, and its `speed`.
    loops
        Work that a CPU second did on the machine that emulated it [loops/s]; 0: it was
        a real computer.
    seconds
        How long each architecture was measured each time [s].
    agent
        CPU of an agent [cores of the reference computer].
    costs
        ``direct``, ``local`` and ``remote`` -> what such connectors cost, as `poise
        calibrate` measured it; empty: it did not.
    """

    robot: str
    poise: str
    computer: str
    speed: float
    at: str
    seconds: float
    loops: float = 0.0
    agent: float = 0.0
    components: Mapping[str, ComponentProfile] = {}
    connectors: Mapping[str, ConnectorProfile] = {}
    costs: Mapping[str, KindCosts] = {}


def with_speed(profile: Profile, speed: float) -> Profile:
    """Return the profile of a real computer as it would be if that had this speed."""
    factor = speed / profile.speed

    def handler(of: HandlerProfile) -> HandlerProfile:
        return _multiplied(of, factor, ("mean", "median", "p99"))

    components = {
        name: structs.replace(
            _multiplied(component, factor, ("share", "repeat")),
            cpu=scaled(component.cpu, factor),
            handlers={n: handler(of) for n, of in component.handlers.items()},
        )
        for name, component in profile.components.items()
    }
    connectors = {
        name: structs.replace(
            each, answering=each.answering and handler(each.answering)
        )
        for name, each in profile.connectors.items()
    }
    return structs.replace(
        _multiplied(profile, factor, ("agent",)),
        speed=speed,
        components=components,
        connectors=connectors,
    )


_HEAD = """\
# Written by `poise profile`; do not edit it.
# CPU in cores of the reference computer, memory and sizes in bytes, times in seconds.
"""
_DIGITS = 4
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""The quick one is not everywhere."""


def to_text(profile: Profile) -> str:
    """Return the profile as YAML; numbers keep `_DIGITS` digits."""
    plain = _rounded(msgspec.to_builtins(profile))
    return _HEAD + yaml.safe_dump(plain, sort_keys=False, default_flow_style=None)


def from_text(text: str, file: str) -> Profile:
    """Return the profile in a YAML text."""
    try:
        plain = yaml.load(text, _LOADER)  # noqa: S506 - both are safe
        if why := _too_old(plain):
            raise RobotError(f"{file}: {why}")
        profile = convert(plain, Profile)
    except msgspec.ValidationError as error:
        raise _no_profile(file, str(error)) from error
    except (yaml.YAMLError, ValueError) as error:  # as for a date that does not exist
        raise RobotError(f"{file}: not YAML: {error}") from error
    if wrong := list(_wrong_amounts(plain)):
        raise _no_profile(file, f"{', '.join(wrong)}, which nothing measures")
    return profile


def _no_profile(file: str, why: str) -> RobotError:
    return RobotError(
        f"{file}: not a profile: {why}. Write it again with `poise profile`"
    )


def _wrong_amounts(value: object, name: str = "") -> Iterator[str]:
    """Yield the numbers in a profile that are below 0, infinite or none."""
    if isinstance(value, dict):
        for key, entry in value.items():
            yield from _wrong_amounts(entry, f"{name}.{key}" if name else str(key))
    elif isinstance(value, int | float) and not 0 <= value < math.inf:
        yield f"{name} is {value}"


def _too_old(plain: object) -> str:
    """Return why a newer Poise has to read a profile; empty: this one tries."""
    by = plain.get("poise") if isinstance(plain, dict) else None
    with contextlib.suppress(ValueError):  # then it is no profile
        return why_too_old(str(by)) if by else ""
    return ""


def read(path: Path) -> Profile:
    """Return the profile in a file; raises as `from_text`, or if it is unreadable."""
    try:
        text = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", "") or error
        raise RobotError(
            f"profile {path} cannot be read: {why}. `poise profile` writes it"
        ) from error
    return from_text(text, str(path))


def _rounded(value: object) -> object:
    if isinstance(value, dict):
        return {key: _rounded(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(entry) for entry in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


_SCHEMA = """
CREATE TABLE IF NOT EXISTS measurements (
    id INTEGER PRIMARY KEY,
    robot TEXT NOT NULL,
    kind TEXT NOT NULL,  -- profile, or costs of connectors
    json TEXT NOT NULL
)
"""


class Store(SqliteFile):
    """Profiles and calibrations by robot; all remain."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, _SCHEMA, "profiles")

    def add(self, profile: Profile) -> None:
        """Add a profile."""
        self._add(profile.robot, "profile", profile)

    def all(self, robot: str) -> list[Profile]:
        """Return every profile of a robot, newest first."""
        profiles = self._newest_first(robot, "profile")
        return [from_json(text, Profile) for text in profiles]

    def add_costs(self, robot: str, costs: Mapping[str, KindCosts]) -> None:
        """Add the costs of connectors on a robot's computers."""
        self._add(robot, "costs", costs)

    def latest_costs(self, robot: str) -> dict[str, KindCosts]:
        """Return the costs of connectors by the last calibration; empty without one."""
        text = next(self._newest_first(robot, "costs"), "{}")
        return from_json(text, dict[str, KindCosts])

    def _add(self, robot: str, kind: str, measured: object) -> None:
        text = msgspec.json.encode(measured).decode()
        self.execute(
            "INSERT INTO measurements (robot, kind, json) VALUES (?, ?, ?)",
            *(robot, kind, text),
        )

    def _newest_first(self, robot: str, kind: str) -> Iterator[str]:
        rows = self.execute(
            "SELECT json FROM measurements WHERE robot = ? AND kind = ?"
            " ORDER BY id DESC",
            *(robot, kind),
        )
        return (text for (text,) in rows)
