"""The ROS 2 context that all nodes of a container share."""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import functools
import importlib
import os
import re
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextvars import ContextVar
from pathlib import Path
from types import ModuleType
from typing import Any

from poise.clock import wall_time
from poise.errors import RobotError
from poise.user_folders import home_folder

_arguments: ContextVar[Sequence[str] | None] = ContextVar("arguments", default=None)
_changing = threading.Lock()
_users = 0
_MALLOPT = {-1: 512 << 20, -3: 32 << 20}
"""M_TRIM_THRESHOLD and M_MMAP_THRESHOLD of mallopt(3) [bytes]."""
_LOCK = re.compile(r"fastdds_[0-9a-f]{16}_el")
_YOUNG = 60.0
"""A younger file may belong to a process that has yet to lock it [s]."""


def rclpy() -> ModuleType:
    """Return rclpy; RobotError where there is none."""
    try:
        return importlib.import_module("rclpy")
    except ImportError as error:
        raise RobotError(
            f"there is no ROS 2 here ({error}): source its setup.bash where `poise` is "
            "started, or on x86-64 `pip install 'poise[ros2]'`"
        ) from None


def join(environment: Mapping[str, str]) -> None:
    """Take part in the context, which begins with the first node; then `leave`."""
    global _users  # noqa: PLW0603, one context a process
    ros = rclpy()
    with _changing:
        if not _users:
            os.environ.update({**home(), **environment})
            _tune()
            remove_leftovers()
            # Poise has signals; and arguments are those of each node
            no_signals = ros.signals.SignalHandlerOptions.NO
            ros.init(args=[], signal_handler_options=no_signals)
            _let_arguments_be_given()
        _users += 1


def leave() -> None:
    """Take part no more; with the last node the context ends, and its memory goes."""
    global _users  # noqa: PLW0603, one context a process
    with _changing:
        _users -= 1
        if not _users:
            rclpy().try_shutdown()


def remove_leftovers(
    folder: Path = Path("/dev/shm"),  # noqa: S108, where Fast DDS has them
    young: float = _YOUNG,
) -> list[str]:
    """Remove the shared memory of killed processes of Fast DDS; return the names.

    Each leaves a segment of half a MB, which is in use as long as a process locks its
    file of the same name with `_el`. Those of ports stay: the next process at a port
    uses them.
    """
    removed = []
    for lock in folder.glob("fastdds_*_el"):
        with contextlib.suppress(OSError):  # in use, another user's, or just removed
            is_ours = lock.stat().st_uid == os.geteuid()
            is_old = wall_time() - lock.stat().st_mtime >= young
            if not (is_ours and is_old and _LOCK.fullmatch(lock.name)):
                continue
            with lock.open("rb") as file:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                segment = lock.with_name(lock.name.removesuffix("_el"))
                segment.unlink(missing_ok=True)
                lock.unlink()
            removed.append(segment.name)
    return removed


def home() -> dict[str, str]:
    """Return what tells ROS 2 where to log, which it refuses to start without."""
    if {"HOME", "ROS_HOME", "ROS_LOG_DIR"} & os.environ.keys():
        return {}
    ours = home_folder()  # as the list of users has it
    if os.access(ours, os.W_OK):
        return {"ROS_HOME": str(ours / ".ros")}
    return {"ROS_LOG_DIR": tempfile.mkdtemp(prefix="poise-ros-")}


@contextlib.contextmanager
def arguments_given(arguments: Sequence[str]) -> Iterator[None]:
    """Give the nodes that are constructed in a block arguments of the command line.

    A class need not know of them, as a `main` needs not: so no line of it is changed.
    """
    token = _arguments.set(arguments)
    try:
        yield
    finally:
        _arguments.reset(token)


def node_of(name: str) -> Any:  # noqa: ANN401, a node
    """Return a node for Poise's own use, with nothing but what it is asked for."""
    from rclpy.node import Node  # noqa: PLC0415, only where a node runs

    return Node(
        name,
        enable_rosout=False,
        start_parameter_services=False,
        use_global_arguments=False,
    )


def drop_messages(node: Any) -> None:  # noqa: ANN401, a node
    """Drop messages that a node's predecessor took, while this one was made ready."""
    for subscription in node.subscriptions:
        if subscription.qos_profile.durability.name != "TRANSIENT_LOCAL":
            with subscription.handle:
                while subscription.handle.take_message(subscription.msg_type, True):
                    pass


def drop_requests(node: Any) -> None:  # noqa: ANN401, a node
    """Drop requests that a node's predecessor took, while this one was made ready."""
    for service in node.services:
        with service.handle:
            kind = service.srv_type.Request
            while service.handle.service_take_request(kind) != (None, None):
                pass


def _tune() -> None:
    """Make room for large messages, unless the user has a profile of Fast DDS.

    What they free is kept: new memory costs more than all copies of a message.
    """
    profile = Path(__file__).with_name("fastdds.xml")
    os.environ.setdefault("FASTDDS_DEFAULT_PROFILES_FILE", str(profile))
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # of glibc
    if mallopt is not None:
        for parameter, value in _MALLOPT.items():
            mallopt(parameter, value)


def _let_arguments_be_given() -> None:
    from rclpy.node import Node  # noqa: PLC0415, only where a node runs

    plain = Node.__init__
    if hasattr(plain, "__wrapped__"):
        return

    @functools.wraps(plain)
    def init(self: Any, *args: Any, **kwargs: Any) -> None:  # noqa: ANN401, as it is
        given = _arguments.get()
        if given is not None and kwargs.get("cli_args") is None:
            kwargs["cli_args"] = list(given)
        plain(self, *args, **kwargs)

    Node.__init__ = init
