"""What a responder is: it sees a situation, and says what should change."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

from msgspec import Struct

from poise.manage.adaptation.situation import Situation
from poise.manage.deploy.desired import Desired


class Change(Struct, frozen=True, kw_only=True):
    """What a responder wants done; nothing of it has happened yet.

    Parameters
    ----------
    why
        The decision, for the journal; empty: what carries it out says it.
    facts
        What led to it, for the journal.
    carry_out
        Does it, by commits. It may wait, and raises `PoiseError` when it fails.
    """

    carry_out: Callable[[], object]
    why: str = ""
    facts: Mapping[str, object] = {}


class Responder(Protocol):
    """Reacts to one kind of trouble. Changes nothing by itself, and never waits.

    Attributes
    ----------
    purpose
        What it is there for, as in "the manager cannot ...".
    """

    @property
    def purpose(self) -> str:
        """Return what it is there for."""
        ...

    def respond(self, situation: Situation, desired: Desired) -> Change | None:
        """Return what should change; None: nothing, so the next responder is asked."""
        ...
