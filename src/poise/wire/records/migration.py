"""What a container is told to do in a move, step by step, and what came of it.

Why the steps come in this order, and what each is for: docs/design/moves.md.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct


class Hold(Struct, frozen=True, tag=True):
    """Queue what goes out over these connectors, behind a mark; calls go on."""

    connectors: tuple[str, ...]
    mark: int


class Release(Struct, frozen=True, tag=True):
    """Send what waits, and all that follows, over the connectors with these keys."""

    keys: tuple[str, ...]


class Offer(Struct, frozen=True, tag=True):
    """Old incarnation: be ready to hand over in the exchange `number`."""

    component: str
    epoch: int
    number: int


class Precopy(Struct, frozen=True, tag=True):
    """New incarnation: join those who will hand over, and fetch a large state already.

    From an incarnation of the same component it will take state, waiting messages and
    timers; from other components what `adapt` (`ComponentSpec`) makes of their states.

    Parameters
    ----------
    olds
        The components that hand over, and their epochs.
    addresses
        Where their containers are reached.
    """

    component: str
    epoch: int
    number: int
    olds: Mapping[str, int]
    addresses: Mapping[str, str]


class Await(Struct, frozen=True, tag=True):
    """New incarnation: ask the old ones already; they answer when they give."""

    component: str
    epoch: int


class Lull(Struct, frozen=True, tag=True):
    """Old incarnation: wait for the end of its work, at most for `limit` [s].

    Then the gate shuts in the best moment: nobody waits for it, and the next work is
    far. It need not come, and the step succeeds all the same.
    """

    component: str
    epoch: int
    limit: float


class Rest(Struct, frozen=True, tag=True):
    """Old incarnation: come to rest, and send a mark behind all that it sent."""

    component: str
    epoch: int
    mark: int


class Flush(Struct, frozen=True, tag=True):
    """Wait until this mark has come to a component, over each of these connectors."""

    component: str
    epoch: int
    connectors: tuple[str, ...]
    mark: int


class Drain(Struct, frozen=True, tag=True):
    """Old incarnation, to which no more comes: work on all that waits."""

    component: str
    epoch: int


class Give(Struct, frozen=True, tag=True):
    """Old incarnation, to which all has come: hand over to whoever asks."""

    component: str
    epoch: int


class Take(Struct, frozen=True, tag=True):
    """New incarnation: take over as soon as the old ones give."""

    component: str
    epoch: int


class Activate(Struct, frozen=True, tag=True):
    """New incarnation, which has taken over: be activated, and stay at rest."""

    component: str
    epoch: int


class Open(Struct, frozen=True, tag=True):
    """Go to work: the new incarnation, or the old one again after a failed move."""

    component: str
    epoch: int


class Retire(Struct, frozen=True, tag=True):
    """Old incarnation: send those that wait for it to the new one."""

    component: str
    epoch: int


Step = (
    Hold
    | Release
    | Offer
    | Precopy
    | Await
    | Lull
    | Rest
    | Flush
    | Drain
    | Give
    | Take
    | Activate
    | Open
    | Retire
)


class Order(Struct, frozen=True, tag=True):
    """Steps of a transition, for one container, one after the other.

    The first that fails ends it.

    Parameters
    ----------
    number
        Tells one order from another.
    limit
        It is answered within this time [s], but may still be taken afterwards.
    """

    number: int
    container: str
    steps: tuple[Step, ...]
    limit: float


class Done(Struct, frozen=True, tag=True):
    """The steps were taken; `seconds` says how long those of each kind took [s]."""

    number: int
    seconds: Mapping[str, float] = {}


class Failed(Struct, frozen=True, tag=True):
    """A step was not taken, and why; all is as before that step."""

    number: int
    reason: str


Outcome = Done | Failed
