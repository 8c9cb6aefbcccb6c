"""What a manager asks of agents, with the answers."""

from __future__ import annotations

import os
from collections.abc import Mapping
from hashlib import blake2s
from math import inf
from pathlib import Path
from typing import Any, Literal

from msgspec import Struct

from poise.clock import boot_time, date_and_time
from poise.wire.codec import Packed
from poise.wire.records.code_records import CodePart, CodeReceived, InstallCode
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.migration_records import MigrationSteps, StepsDone, StepsFailed

PROTOCOL = 14
"""The version of all records here and beside, higher where one of them has changed."""
LEAST_PROTOCOL = 12
"""The oldest version whose programs this one understands, and that understand it.

Such records differ in fields alone: a new one has a default, and an unknown one is
ignored. Requests and answers of a new kind go only to programs that have it.
"""


class Versioned(Struct, frozen=True, kw_only=True):
    """What a program says that may be of another version than its reader."""

    protocol: int = PROTOCOL
    least: int = LEAST_PROTOCOL

    @property
    def is_understood(self) -> bool:
        """Whether writer and reader understand each other."""
        return self.least <= PROTOCOL and self.protocol >= LEAST_PROTOCOL


class ManagerId(Struct, frozen=True, kw_only=True):
    """One start of a manager."""

    key: str  # Unique; its liveliness token is ``poise/ROBOT/manager/KEY``
    # Where it runs, for people
    user: str
    host: str
    pid: int
    since: float  # When it started [s since 1970]
    control: str = ""  # Its control socket, on its computer
    # Higher than that of every manager which an agent obeyed when this one began to
    # claim them; 0 before. Of two managers the one with the lower `rank` gives way
    term: int = 0

    @property
    def rank(self) -> tuple[int, float, str]:
        """Which of two managers is the later one: clocks of computers may differ."""
        return self.term, self.since, self.key

    def __str__(self) -> str:
        """Return who it is, for people."""
        began = date_and_time(self.since)
        return f"user {self.user} on {self.host} (process {self.pid}) since {began}"


class Election(Struct, frozen=True, kw_only=True):
    """How the managers of a robot follow each other (docs/design/leader.md)."""

    votes: Mapping[str, int]  # Computer -> how many votes its agent has
    # The computers where a standby waits, the first one to lead first
    managers: tuple[str, ...] = ()
    setup: bytes = b""  # What a standby has to know; only managers read it


def majority_at(votes: Mapping[str, int], moments: Mapping[str, float]) -> float:
    """Return the last moment that agents with a majority have reached; else -inf."""
    most, got = sum(votes.values()), 0
    for name in sorted(votes, key=lambda name: -moments.get(name, -inf)):
        got += votes[name]
        if 2 * got > most:
            return moments.get(name, -inf)
    return -inf


class Claim(Struct, frozen=True, tag=True):
    """Obey this manager from now on."""

    manager: ManagerId
    take_over: bool = False  # Even if another one is obeyed
    # Computer -> zenoh endpoint, of all agents of the robot: they exchange heartbeats
    agents: Mapping[str, str] = {}
    # Whether the manager exchanges heartbeats with them, too; else nothing is leased
    is_leased: bool = False
    # How managers follow each other; None: they do not, and need no votes
    election: Election | None = None
    is_poll: bool = False  # Whether it is only asked, and nothing changes


class Claimed(Struct, frozen=True, tag=True):
    """An agent's answer to a claim: it obeys the manager from now on."""

    # What it works towards, as an earlier manager told it; None: nothing yet
    deployment: Deployment | None = None
    # Whether its lease had ended: what may move is inactive there, and may have been
    # started elsewhere
    is_cut_off: bool = False
    # Whom else it has heard of its robot, and for how long it has not [s]; the manager
    # before is `MANAGER`
    silent: Mapping[str, float] = {}


class ReadOutput(Struct, frozen=True, tag=True, kw_only=True):
    """Tell what was written on a computer."""

    component: str = ""  # Only its lines; empty: all
    after: int = 0  # Only what was written later [ns since 1970]
    most: int = 1_000  # Of more lines than this, only the last


class OutputLine(Struct, frozen=True, kw_only=True):
    """A line that was written to standard output or error, or logged."""

    at: int  # When [ns since 1970], by the clock of its computer
    # Whose thread wrote it; of a call, the caller's. Else the name of the container
    component: str
    text: str
    computer: str = ""


class OutputLines(Struct, frozen=True, tag=True, kw_only=True):
    """Lines, oldest first; `omitted` counts those before, which are over `most`."""

    lines: tuple[OutputLine, ...] = ()
    omitted: int = 0
    now: int = 0  # When this was told, by the same clock as the lines; 0: not known


SHOWN_ITEMS = 16
"""The most items of a list, an array or a mapping that are shown to people."""


class Tap(Struct, frozen=True, tag=True, kw_only=True):
    """Tell what has gone out over a connector since the last time.

    A container taps the connector for some seconds; who goes on looking asks again.
    """

    number: int  # Tells this request from others
    container: str
    connector: str
    viewer: str  # Each viewer gets everything
    is_whole: bool = False  # Whether contents are `Packed`, and not shortened
    # Where a port is ``published(latest=True)``: its last message comes, too, when it
    # is later than this one, which the viewer has; None: it does not
    latest: tuple[int, int] | None = None
    # Messages a second that are reported with their content; 0: none
    rate: float = 0.0
    # Of longer lists, arrays and mappings the rest is left out; up to `SHOWN_ITEMS`,
    # lists and mappings then end with how much that is
    items: int = SHOWN_ITEMS
    limit: float = 1.0  # It is answered within this time [s]


class Passed(Struct, frozen=True):
    """A message, or a call."""

    at: float  # When it went out, or the call's answer came [s since 1970]
    value: Any  # Its content as plain values, shortened where it is long
    is_whole: bool = True  # Whether nothing was shortened


class TapReading(Struct, frozen=True, tag=True, kw_only=True):
    """What went out since the last reading."""

    number: int
    connector: str
    carries: str  # The declared type of the messages, or the interface
    # When each message or call went out [s since 1970]; some may be missing
    times: tuple[float, ...] = ()
    passed: tuple[Passed, ...] = ()  # Some of them with their content
    missing: int = 0  # How many are not among the times: there was no room for them
    # The number of the last message, where a port is ``published(latest=True)``
    latest: tuple[int, int] = (0, 0)
    at: float = 0.0  # When it was read, by the clock of the times; 0: not known


MOST_PACKED = 16 << 20
"""No more comes from outside, or goes out there, at once [bytes]."""


PARAMETERS = "parameters"
"""The port of every component that answers ``get()`` and ``set(name=value, ...)``."""


class PortRequest(Struct, frozen=True, tag=True, kw_only=True):
    """Give a port a message, publish one there, or call it, for somebody outside.

    `value` has the message, or a call's positional and named arguments.
    """

    number: int
    container: str
    component: str
    port: str
    method: str  # Empty: a message
    value: Packed
    limit: float  # It is answered within this time [s]


class PortAnswer(Struct, frozen=True, tag=True, kw_only=True):
    """What came of a request; only ``done`` has a `value`.

    It was ``raised`` by the callee, ``refused`` as it does not fit, ``late``, or done
    with a result that ``cannot cross``. Or the component is ``away``: then nothing was
    done, and it may be asked at another place.
    """

    number: int
    outcome: Literal["done", "raised", "refused", "late", "cannot cross", "away"]
    value: Packed = Packed(b"\xc0")
    reason: str = ""
    error_type: str = ""
    traceback: str = ""


MOST_KEPT = 64 << 20
"""A larger state is not kept [bytes]."""


class CheckpointCopy(Struct, frozen=True, kw_only=True, tag=True):
    """A component's state as its agent keeps it."""

    component: str
    epoch: int
    data: bytes | None  # The content of the file; None: it is the same as before
    age: float  # How old it was when this was sent [s]


def checkpoint_path(folder: Path, component: str, epoch: int) -> Path:
    """Return the file of an incarnation's last checkpoint."""
    name = blake2s(f"{component} {epoch}".encode(), digest_size=8).hexdigest()
    return folder / f"{name}.checkpoint"


def set_age(path: Path, age: float = 0.0) -> None:
    """Set a checkpoint's age [s] by its file's time on `boot_time`."""
    os.utime(path, (boot_time() - age,) * 2)


def age_of(modified: float) -> float:
    """Return a checkpoint's age [s] at least, by the ``st_mtime`` of its file."""
    now = boot_time()
    return now - modified if modified <= now else now


class Accepted(Struct, frozen=True, tag=True):
    """An agent's answer: it works towards the deployment."""


class Refused(Struct, frozen=True, tag=True):
    """An agent's answer: it changed nothing, and why."""

    reason: str
    # Whether it obeys another manager
    obeys_another: bool = False


Answer = (
    Accepted
    | Claimed
    | Refused
    | StepsDone
    | StepsFailed
    | TapReading
    | PortAnswer
    | OutputLines
    | CodeReceived
)

Request = (
    Claim
    | Deployment
    | MigrationSteps
    | CheckpointCopy
    | Tap
    | PortRequest
    | ReadOutput
    | CodePart
    | InstallCode
)
"""What a manager asks of an agent."""


class ManagerRequest(Versioned, frozen=True, kw_only=True):
    """A request with its manager's fencing token: agents refuse any other."""

    token: int
    request: Request
