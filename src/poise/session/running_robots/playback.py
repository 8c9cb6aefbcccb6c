"""Publishes what `poise record` wrote, into a robot that is up."""

from __future__ import annotations

import heapq
import re
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from functools import cache
from numbers import Real
from pathlib import Path

from msgspec import Struct

from poise.errors import UsageError
from poise.session import Check, Say, log, nothing, sleep_until
from poise.session.arguments import check_names, check_path, check_type
from poise.session.running_robots.running import connect
from poise.session.running_robots.running_component import RunningComponent
from poise.wire.bag_file import is_bag
from poise.wire.recording_file import Said, said_in

CALLS = "calls are not played"
_LIMIT = 10.0
"""A component takes a message within this time [s], or the playback ends."""
_TURN = 5.0
"""A message is in the file at most this long after a later one [s]."""
_SOURCE = re.compile(r"(.+?)\.([A-Za-z_]\w*)-.+")


class Playback(Struct, frozen=True, kw_only=True):
    """What was played.

    Parameters
    ----------
    messages
        ``component.port`` -> messages that it published.
    skipped
        ``component.port`` -> why nothing of it was played.
    behind
        By how much the last message was later than in the recording [s].
    """

    messages: Mapping[str, int]
    skipped: Mapping[str, str]
    behind: float


def play(
    path: Path | str,
    *,
    robot: str | None = None,
    rate: float = 1.0,
    only: Collection[str] = (),
    say: Say = log.info,
    check: Check = nothing,
) -> Playback:
    """Publish the messages of a recording, each at its component's port, in time.

    They come beside what the component publishes itself. Calls are not played.

    Parameters
    ----------
    path
        A file of `poise.record`.
    robot
        The robot's name; None: the only one that runs here.
    rate
        So many times as quickly as it was recorded; > 0.
    only
        The ports, as ``component.port``; empty: all in the recording.
    say
        Takes a sentence for each port of which nothing can be played.
    check
        Called several times a second; may raise `KeyboardInterrupt`.

    Raises
    ------
    UsageError
        There is no such robot, file or port, or it is no recording of messages.
    RunError
        A component took no message within 10 s.
    """
    check_path("path", path)
    check_names("only", only)
    check_type("rate", rate, Real, "a number")
    if not rate > 0:
        raise UsageError(f"rate {rate:g}: must be above 0")
    if is_bag(Path(path)):
        raise UsageError(
            f"{path} is no file of `poise record`. If it is a bag of ROS 2, `ros2 bag "
            "play` plays it, and the robot's bridges and nodes hear it"
        )
    component = cache(connect(robot).component)  # asks the manager whether it is there
    known = set(map(_source, said_in(Path(path)))) if only else set()
    if unknown := {*only} - known:
        raise UsageError(f"{path} has nothing of {', '.join(sorted(unknown))}")
    messages, skipped = Counter[str](), dict[str, str]()
    used: dict[str, str] = {}
    """Port -> the connector whose messages are played: others have the same."""
    began, first, behind = time.monotonic(), 0.0, 0.0
    for said in _in_order(said_in(Path(path), warns=not only)):  # it did already
        port = _source(said)
        first = first or said.at
        is_asked = not only or port in only
        if not is_asked or used.setdefault(port, said.connector) != said.connector:
            continue
        if port in skipped:
            continue
        due = began + (said.at - first) / rate
        sleep_until(due, check)
        check()
        if why := _publish(component, port, said):
            skipped[port] = why
            say(f"{port} is not played: {why}")
            continue
        messages[port] += 1
        behind = max(0.0, time.monotonic() - due)
    if not used:
        raise UsageError(
            f"no message is recorded in {path}: `poise record` records those of the "
            "connectors that it is given"
        )
    return Playback(messages=messages, skipped=skipped, behind=behind)


def _in_order(said: Iterable[Said]) -> Iterator[Said]:
    """Yield what was said by time: in a file, connectors take turns."""
    waiting: list[tuple[float, int, Said]] = []
    for number, each in enumerate(said):
        heapq.heappush(waiting, (each.at, number, each))
        while waiting[0][0] < each.at - _TURN:
            yield heapq.heappop(waiting)[2]
    yield from (each for _, _, each in sorted(waiting))


def _source(said: Said) -> str:
    """Return what published it, as ``component.port``."""
    if (found := _SOURCE.fullmatch(said.connector)) is None:
        raise UsageError(f"'{said.connector}' in the recording is not a connector")
    return f"{found[1]}.{found[2]}"


def _publish(
    component: Callable[[str], RunningComponent], port: str, said: Said
) -> str:
    """Publish a message; return why that cannot be done."""
    owner, _, name = port.rpartition(".")
    try:
        component(owner).publish(name, said.value, limit=_LIMIT)
    except UsageError as error:
        # a call is recorded with how long it took, and its outcome
        has = said.value.keys() if isinstance(said.value, dict) else set[str]()
        is_call = "seconds" in has and bool({"returned", "raised"} & has)
        return CALLS if is_call else str(error)
    return ""
