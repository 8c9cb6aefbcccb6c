"""What the manager's zenoh threads do with the messages of agents: store them."""

from __future__ import annotations

import getpass
import os
import socket
import time
import uuid
from collections.abc import Callable, Iterable
from queue import SimpleQueue
from typing import TypeVar

import msgspec
import zenoh

from poise.wire.records.deployment import Accepted, Answer, ManagerId, Refused
from poise.wire.records.migration import StepsDone, StepsFailed

S = TypeVar("S")
Replies = SimpleQueue[tuple[int, zenoh.Reply | None]]
"""The number of an order, and a reply to it, or None at the end of its replies."""


def manager_id() -> ManagerId:
    """Return an identity for a manager that starts now."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # it has no name
        user = str(os.getuid())
    return ManagerId(
        key=uuid.uuid4().hex,
        user=user,
        host=socket.gethostname(),
        pid=os.getpid(),
        since=time.time(),
    )


def reading(
    type_: type[S], take: Callable[[S], object], refuse: Callable[[str], object]
) -> Callable[..., None]:
    """Return what takes the records of a type from agents, and refuses others."""
    decode = msgspec.msgpack.Decoder(type_).decode

    def hear(sample: zenoh.Sample) -> None:
        try:
            record = decode(sample.payload.to_bytes())
        except msgspec.DecodeError as error:
            refuse(f"a record at {sample.key_expr} was refused: {error}")
        else:
            take(record)

    return hear


def note(replies: Replies, number: int, reply: zenoh.Reply | None = None) -> None:
    """Store a reply, or the end of replies; for zenoh's threads."""
    replies.put((number, reply))


def _decoded(sample: zenoh.Sample) -> Accepted | Refused | StepsDone | StepsFailed:
    """Return an agent's answer; `Refused` when it is none."""
    try:
        answer: Accepted | Refused | StepsDone | StepsFailed = msgspec.msgpack.decode(
            sample.payload.to_bytes(), type=Answer
        )
    except msgspec.DecodeError as error:
        return Refused(f"not an answer: {error}")
    return answer


def answer_of(
    replies: Iterable[zenoh.Reply],
) -> Accepted | Refused | StepsDone | StepsFailed | None:
    """Return the first answer of an agent; `None` when it gave none."""
    return next((_decoded(reply.ok) for reply in replies if reply.ok is not None), None)
