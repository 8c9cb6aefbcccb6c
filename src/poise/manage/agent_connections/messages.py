"""What the manager's zenoh threads do with the messages of agents: store them."""

from __future__ import annotations

import getpass
import os
import socket
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue
from typing import TypeVar

import msgspec
import zenoh

from poise.wire.records.requests import Answer, ManagerId, Refused

S = TypeVar("S")
K = TypeVar("K")


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


def has_ended(manager: ManagerId) -> bool:
    """Return whether a manager of this computer has ended; False where unknown."""
    is_here = manager.host == socket.gethostname()
    return is_here and not Path(f"/proc/{manager.pid}").exists()


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


def note(
    replies: SimpleQueue[tuple[K, zenoh.Reply | None]],
    key: K,
    reply: zenoh.Reply | None = None,
) -> None:
    """Store a reply, or None at the end of replies; for zenoh's threads."""
    replies.put((key, reply))


def answer_of(reply: zenoh.Reply | None) -> Answer | None:
    """Return an agent's answer: None when it gave none, `Refused` when it is none."""
    if reply is None or reply.ok is None:
        return None
    try:
        answer: Answer = msgspec.msgpack.decode(
            reply.ok.payload.to_bytes(), type=Answer
        )
    except msgspec.DecodeError as error:
        return Refused(f"not an answer: {error}")
    return answer
