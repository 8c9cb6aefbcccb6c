"""Where a running robot is asked for things: `poise status`, `move`, `balance` ...

A socket in the user's runtime folder, one record there and one back. The manager's
own thread answers, between two looks at the robot: nothing happens at the same time.
Whoever asks meanwhile waits in the socket's queue; who leaves it gets nothing done, and
who is left in it when the robot stops is told so.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from msgspec import Struct

from poise.errors import PoiseError, RunError, Timeout, UsageError
from poise.manage.adaptation.replan import Proposal
from poise.manage.migration.move import MoveReport
from poise.manage.migration.replacement import ReplaceReport
from poise.manage.migration.transition_run import TransitionReport
from poise.manage.observe.estimates import DemandEstimate
from poise.wire import record_channel
from poise.wire.codec import WireError
from poise.wire.connections.socket_path import connect
from poise.wire.records.deployment import AgentStatus

ANSWER_LIMIT = 60.0
"""The manager answers within this time [s]; moves of large states take the longest."""
_MOST_WAITING = 64
"""At most this many clients queue; further ones wait to connect."""


class AskStatus(Struct, frozen=True, tag=True):
    """Tell how the robot is."""


class AskMove(Struct, frozen=True, tag=True):
    """Move a component."""

    component: str
    computer: str


class AskReplace(Struct, frozen=True, tag=True):
    """Swap a component's implementation; `adapt` maps its state."""

    component: str
    implementation: str
    adapt: str = ""


class AskAlternative(Struct, frozen=True, tag=True):
    """Put the architecture `by` in the place of another; `adapt` maps the states."""

    architecture: str
    by: str
    adapt: str = ""


class AskBalance(Struct, frozen=True, tag=True):
    """Place the robot anew, unless `dry`; `move` is what moving a component costs."""

    move: float
    dry: bool = False


class AskStop(Struct, frozen=True, tag=True):
    """Stop the robot."""


Ask = AskStatus | AskMove | AskReplace | AskAlternative | AskBalance | AskStop


class Asked(Struct, frozen=True):
    """What is asked."""

    what: Ask


class RobotStatus(Struct, frozen=True, tag=True, kw_only=True):
    """How the robot is: where components run, and what the agents said last.

    `standings` say what components need now, against what their profile says.
    """

    robot: str
    task: str
    placement: Mapping[str, str]
    computers: Mapping[str, AgentStatus]
    lost: tuple[str, ...] = ()
    demand_estimates: tuple[DemandEstimate, ...] = ()


class Stopping(Struct, frozen=True, tag=True):
    """The robot stops."""


class Moved(Struct, frozen=True, tag=True):
    """What came of a move or replacement."""

    report: MoveReport


class Balanced(Struct, frozen=True, tag=True):
    """What was proposed, and what came of it; no report when nothing was done."""

    proposal: Proposal
    report: TransitionReport | None = None


class Replaced(Struct, frozen=True, tag=True):
    """What came of the replacement of an architecture."""

    report: ReplaceReport


class Refusal(Struct, frozen=True, tag=True):
    """It was not done, and why."""

    reason: str


Answer = RobotStatus | Stopping | Moved | Replaced | Balanced


class Answered(Struct, frozen=True):
    """What is answered."""

    what: Answer | Refusal


class ControlServer:
    """The manager's side.

    Raises
    ------
    UsageError
        A robot of this name runs already.
    RunError
        Its socket cannot be had, or the folder for it is another user's.
    """

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._path = _path_of(robot)
        try:
            self._make_folder()
            self._listener = _listening(self._path)
        except OSError as error:
            raise RunError(
                f"{self._path} cannot be listened on ({error}): set XDG_RUNTIME_DIR to "
                "a folder of yours with a short path"
            ) from error

    def _make_folder(self) -> None:
        folder = self._path.parent
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if folder.stat().st_uid != os.getuid():
            raise RunError(
                f"{folder} is another user's: set XDG_RUNTIME_DIR to a folder of yours"
            )
        if _is_alive(self._path):
            name = self._robot
            raise UsageError(f"robot '{name}' runs already; `poise stop` ends it")
        for left in folder.glob("*.sock"):  # by managers that were killed
            if not _is_alive(left):
                left.unlink(missing_ok=True)

    def serve(self, answer: Callable[[Asked], Answered], limit: float) -> bool:
        """Answer one asker; False when none comes within `limit` [s].

        `answer` may raise PoiseError, which is a refusal. It is not asked for one who
        has left: whoever gave up does not expect it to be done any more.
        """
        ready, _, _ = select.select([self._listener], [], [], limit)
        if not ready:
            return False
        connection, _ = self._listener.accept()
        with connection, contextlib.suppress(WireError, RunError):
            asked = record_channel.receive(connection, Asked)
            if _has_left(connection):
                return True
            try:
                answered = answer(asked)
            except PoiseError as error:
                answered = Answered(Refusal(str(error)))
            record_channel.send(connection, answered)
        return True

    def close(self) -> None:
        """Be asked no more; those who wait are told that the robot has stopped."""
        self._path.unlink(missing_ok=True)
        while self.serve(self._refuse, 0.0):
            pass
        self._listener.close()

    def _refuse(self, _: Asked) -> Answered:
        return Answered(Refusal(f"robot '{self._robot}' has stopped"))


def ask(robot: str | None, what: Ask) -> Answer:
    """Ask the manager of a running robot.

    Parameters
    ----------
    robot
        Its name; None when only one runs.

    Raises
    ------
    UsageError
        No such robot runs, or several do and none is named; or the manager refuses.
    RunError
        The manager does not answer within `ANSWER_LIMIT`.
    """
    path = _find(robot)
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            connect(connection, path, record_channel.LIMIT)
            record_channel.send(connection, Asked(what))
            if not select.select([connection], [], [], ANSWER_LIMIT)[0]:
                raise Timeout(
                    f"it is busy since {ANSWER_LIMIT:g} s; what it has begun goes on, "
                    "and `poise status` shows what came of it"
                )
            answered = record_channel.receive(connection, Answered).what
    except (OSError, RunError, WireError) as error:
        raise RunError(f"robot '{path.stem}' gave no answer: {error}") from error
    if isinstance(answered, Refusal):
        raise UsageError(answered.reason)
    return answered


def _folder() -> Path:
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime:
        return Path(runtime) / "poise"
    return Path(tempfile.gettempdir()) / f"poise-{os.getuid()}"


def _path_of(robot: str) -> Path:
    return _folder() / f"{robot}.sock"


def _find(robot: str | None) -> Path:
    running = {p.stem: p for p in sorted(_folder().glob("*.sock")) if _is_alive(p)}
    if robot is None and len(running) == 1:
        return next(iter(running.values()))
    if robot in running:
        return running[robot]
    names = ", ".join(running) or "none"
    if robot is None and running:
        raise UsageError(f"several robots run ({names}): name one with --robot")
    which = f"robot '{robot}' does not run" if robot else "no robot runs"
    raise UsageError(f"{which} here (running: {names}); `poise up FILE` starts one")


def _listening(path: Path) -> socket.socket:
    """Return a socket that listens, and is at `path` only since it does."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        draft = path.with_suffix(f".{os.getpid()}")
        listener.bind(os.fspath(draft))
        listener.listen(_MOST_WAITING)
        draft.rename(path)
    except OSError:
        listener.close()
        raise
    return listener


def _is_alive(path: Path) -> bool:
    """Return at once whether somebody listens, however many wait there already."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(os.fspath(path))
        except BlockingIOError:
            return True
        except OSError:
            return False
        return True


def _has_left(connection: socket.socket) -> bool:
    try:
        return not connection.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
    except BlockingIOError:
        return False
    except OSError:
        return True
