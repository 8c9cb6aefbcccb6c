"""Sends and takes heartbeats: datagrams, on a thread that goes first.

A heartbeat names the last heartbeats that its sender has heard: so each participant
knows on its own clock up to when it was heard. After a cut, TCP would be silent for
longer than the cut, and hold back all that comes after a lost packet.
"""

from __future__ import annotations

import contextlib
import logging
import socket
import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

import msgspec

from poise import threads
from poise.clock import Clock
from poise.decoding import msgpack_decoder
from poise.endpoint import Endpoint
from poise.errors import Sparing
from poise.priority import go_first
from poise.wire.address import family_of
from poise.wire.codec import MALFORMED
from poise.wire.host_names import MAPPED, HostNames
from poise.wire.records.heartbeat_records import MANAGER, Echo, Heartbeat, LinkQuality

if TYPE_CHECKING:
    from poise.wire.credentials import Credentials

log = logging.getLogger(__name__)

EVERY = 0.1
"""A heartbeat goes out this often [s]."""
_PATIENT = 0.13
"""An agent that answers heartbeats sends others only after this time [s]."""
ASK_AFTER = 0.2
"""Who is silent for longer is asked for a heartbeat [s]."""
ASK_EVERY = 0.025
UNHEARD_AFTER = 0.4
"""Who is silent for longer is out of reach [s]."""
LEASE = 0.7
"""An agent that its manager has not heard for longer is cut off [s]."""
SURELY_ENDED = 0.95
"""The lease of an agent that is silent for longer has ended, on its clock, too [s]."""
LEASES_END_WITHIN = 3.0
"""So long is waited for the leases of lost computers, unless others hear them [s]."""
UNCUT_LEASE = 10.0
"""The lease of agents that nothing can cut off from their manager, but that may have to
wait for CPU: each holds it while it runs [s]."""
UNCUT_SURELY_ENDED = 11.0
_WINDOW = 50
"""The number of heartbeats over which loss is counted."""
_IN_A_ROW = 2
"""Of heartbeats in a row that did not come, this many count as lost: else one short cut
would look like a bad link for as long as the window lasts."""
_DELAYS = 15
_FORGOTTEN = 3.0
"""Who is silent for longer is named no more [s]."""


class Contact:
    """What one participant knows of another."""

    def __init__(self, beat: Heartbeat, now: float) -> None:
        self.last = beat
        self.began = self.heard_at = now  # when the first and the last came [s]
        self.acked: float | None = None  # of the last own one that the other heard [s]
        # the same, or when that one had been confirmed itself, if that was before
        self.granted: float | None = None
        self._lost: deque[int] = deque(maxlen=_WINDOW)
        self._delays: deque[float] = deque(maxlen=_DELAYS)

    def note(self, beat: Heartbeat, echo: Echo | None, now: float) -> None:
        """Take in a heartbeat, which says what the other has heard of this side."""
        gap = beat.number - self.last.number - 1
        self._lost.append(min(gap, _IN_A_ROW) if gap > 0 else 0)
        self.last, self.heard_at = beat, now
        if echo is None or not (sent := echo.sent) <= now:
            return  # no heartbeat went out then: it would extend leases for ever
        held, managed = echo.held, beat.managed
        if self.acked is None or sent > self.acked:
            self.acked = sent
            self._delays.append(max(0.0, now - sent - held) / 2)
        if managed is not None:
            granted = sent - (managed - held) if managed > held else sent
            if self.granted is None or granted > self.granted:
                self.granted = granted

    def quality(self, now: float) -> LinkQuality:
        """Return how the way from and to the other is."""
        silent = now - self.heard_at
        missed = max(0, int(silent / EVERY) - 1)
        lost = min(missed, _IN_A_ROW) + sum(self._lost)
        return LinkQuality(
            delay=_median(self._delays) if self._delays and silent < LEASE else None,
            loss=lost / (lost + len(self._lost)) if self._lost else 0.0,
            silent=silent,
        )


def _median(values: Iterable[float]) -> float:
    """Return the median; `statistics.median` takes four times as long for so few."""
    ordered = sorted(values)
    return (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2


_ENDED_STARTS = 64
"""So many starts of other computers are remembered that have ended."""


class Contacts:
    """Whom one participant hears: a computer, or `MANAGER`; `key` is of this start."""

    def __init__(self, robot: str, name: str, key: str) -> None:
        self.name = name
        self._robot = robot
        self.key = key
        self._number = 0
        self._sent: deque[float] = deque(maxlen=_WINDOW)
        self._contacts: dict[str, Contact] = {}
        self._ended: deque[tuple[str, str]] = deque(maxlen=_ENDED_STARTS)
        self.was_revoked = False
        """Whether any heartbeat has revoked a fencing token."""

    def note(self, beat: Heartbeat, now: float) -> bool:
        """Take in a heartbeat at `now` [s]; return whether it was news."""
        if beat.robot != self._robot or beat.sender == self.name:
            return False
        contact = self._contacts.get(beat.sender)
        if contact is None or contact.last.key != beat.key:
            if (beat.sender, beat.key) in self._ended:
                return False  # of a start before, and recorded by somebody
            if contact is not None and beat.sender != MANAGER:  # there may be several
                self._ended.append((beat.sender, contact.last.key))
            contact = self._contacts[beat.sender] = Contact(beat, now)
        elif beat.number <= contact.last.number:
            return False  # it was overtaken
        contact.note(beat, beat.heard.get(self.name), now)
        if beat.revoked:
            self.was_revoked = True
        return True

    def forget(self, name: str) -> None:
        """Know nothing of another any more, until it is heard again."""
        self._contacts.pop(name, None)

    def next_beat(
        self,
        now: float,
        *,
        managed: float | None = 0.0,
        manager: str = "",
        is_cut_off: bool = False,
        asks: Iterable[str] = (),
        revoked: Mapping[str, int] | None = None,
    ) -> Heartbeat:
        """Return this side's heartbeat at `now` [s]."""
        self._number += 1
        self._sent.append(now)
        return Heartbeat(
            robot=self._robot,
            sender=self.name,
            key=self.key,
            number=self._number,
            sent=now,
            heard={
                name: Echo(
                    contact.last.sent, now - contact.heard_at, contact.last.is_cut_off
                )
                for name, contact in self._contacts.items()
                if now - contact.heard_at < _FORGOTTEN
            },
            managed=managed,
            manager=manager,
            is_cut_off=is_cut_off,
            asks=tuple(asks),
            revoked=revoked or {},
        )

    def pause(self, now: float) -> float:
        """Return how long to wait at most until the next heartbeat [s]."""
        manager = self._contacts.get(MANAGER)
        answers = manager is not None and now - manager.heard_at < EVERY
        return _PATIENT if answers else EVERY

    def get(self, name: str) -> Contact | None:
        """Return what is known of another; None: it was never heard."""
        return self._contacts.get(name)

    def unheard(self, now: float) -> list[str]:
        """Return who was heard, and is not any more."""
        return [
            name
            for name, contact in self._contacts.items()
            if now - contact.heard_at > UNHEARD_AFTER
        ]

    def unanswered_since(self, name: str) -> float:
        """Return when the first own heartbeat went out that it lacks [s]; else inf."""
        contact = self._contacts.get(name)
        acked = contact.acked if contact is not None else None
        first = float("inf")
        for at in reversed(self._sent):
            if acked is not None and at <= acked:
                break
            first = at
        return first

    def relayed(self, name: str, now: float) -> tuple[str, float] | None:
        """Return who heard another last, and when at the latest [s], but for itself."""
        echoes = [
            (contact.heard_at - echo.held, other)
            for other, contact in self._contacts.items()
            if other not in {name, MANAGER} and now - contact.heard_at < UNHEARD_AFTER
            for echo in [contact.last.heard.get(name)]
            if echo is not None and not echo.is_cut_off
        ]
        if not echoes:
            return None
        at, other = max(echoes)
        return other, at

    def qualities(self, now: float) -> Mapping[str, LinkQuality]:
        """Return how the ways to all other computers are."""
        return {
            name: contact.quality(now)
            for name, contact in sorted(self._contacts.items())
            if name != MANAGER
        }


_APART = 0.01
"""Heartbeats of one sender are so far apart at least [s]: two that answer each other at
once would send thousands in a second."""
_LARGEST = 16384
_JOIN_LIMIT = 1.0
_READING = 0.02
"""What waits is read for this time at most [s]: far more than the kernel holds."""
Address = tuple[str, int]


Received = tuple[Heartbeat, Address, float]
"""A heartbeat, where it came from, and when [s]."""
Hear = Callable[[Sequence[Received]], bool]
"""Takes in the heartbeats that came; returns whether to send one at once."""
NextBeat = Callable[[], tuple[Heartbeat, float]]
"""Called before each sending, when all that came was heard; returns what is sent, and
how long to wait for the next time [s]."""


class Datagrams(Protocol):
    """Carries heartbeats, each of which may be lost, for one thread."""

    def receive(self, until: float) -> Sequence[Received]:
        """Return what has come; when nothing has, wait for it until a moment [s]."""

    def send(self, beat: Heartbeat, targets: Iterable[Address]) -> None:
        """Send a heartbeat to all targets."""

    def close(self) -> None:
        """End."""


class UdpDatagrams:
    """A UDP socket: at `listen`, else anywhere, for IPv4 and IPv6; `keys` sign."""

    def __init__(
        self,
        clock: Clock,
        listen: Endpoint | None = None,
        *,
        keys: Credentials | None = None,
    ) -> None:
        self._clock = clock
        self._keys = keys
        if keys is not None:
            _ = keys.signing  # here, and on no thread, damaged ones are told
        family = _family_of_both() if listen is None else family_of(listen.host)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._names = HostNames(family)
        if listen is None and family is socket.AF_INET6:
            self._socket.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
        if listen is not None:
            try:
                self._socket.bind((listen.host, listen.port))
            except OSError:
                self._socket.close()
                raise
        self._decode = msgpack_decoder(Heartbeat).decode
        self._sparing = Sparing(log)

    def receive(self, until: float) -> Sequence[Received]:
        """Return what has come, as far as it can be read in `_READING`."""
        received: list[Received] = []
        now = self._clock.now()
        most = max(until, now + _READING)
        while now < most:
            self._socket.settimeout(0.0 if received else max(until - now, 0.0))
            try:
                data, source = self._socket.recvfrom(_LARGEST)
                now = self._clock.now()
                beat = self._read(data, source[0])
                if beat is not None:
                    if not received:
                        most = min(most, now + _READING)
                    received.append((beat, source[:2], now))
            except (BlockingIOError, TimeoutError):
                break
            except OSError:  # what an earlier datagram met on its way
                if until <= now:
                    break
                now = self._clock.now()
        return received

    def send(self, beat: Heartbeat, targets: Iterable[Address]) -> None:
        """Send a heartbeat to all targets; the silence says which link is cut.

        Those whose names have not been looked up yet get the next one. A name may have
        several addresses; at which of them its agent listens is not known.
        """
        data = msgspec.msgpack.encode(beat)
        if self._keys is not None:
            data = self._keys.sign(data)
        for host, port in targets:
            for address in self._names.find(host):
                with contextlib.suppress(OSError):
                    self._socket.sendto(data, (address, port))

    def close(self) -> None:
        """Close the socket."""
        self._names.close()
        self._socket.close()

    def _read(self, data: bytes, source: str) -> Heartbeat | None:
        """Return the heartbeat in a datagram; None: it is not of this robot."""
        try:
            known = data if self._keys is None else self._keys.verified(data)
            if known is not None:
                return self._decode(known)
            what = "is not signed with this robot's keys"
        except MALFORMED:
            what = "is not of this version"
        sender = source.removeprefix(MAPPED)
        self._sparing.warn("ignored", "a heartbeat from %s %s: ignored", sender, what)
        return None


def _family_of_both() -> socket.AddressFamily:
    """Return whose sockets reach IPv4, and IPv6 where the kernel has it."""
    return socket.AF_INET6 if socket.has_dualstack_ipv6() else socket.AF_INET


class Heartbeats:
    """A thread that sends one heartbeat to all every `EVERY`, and takes what comes."""

    def __init__(
        self, clock: Clock, hear: Hear, next_beat: NextBeat, datagrams: Datagrams
    ) -> None:
        self._clock = clock
        self._hear = hear
        self._next_beat = next_beat
        self._datagrams = datagrams
        self._targets: Mapping[str, Address] = {}
        self._ended = threading.Event()
        self._thread = threads.daemon(self._main, "heartbeats", again=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def close(self) -> None:
        """End."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join(_JOIN_LIMIT)
        self._datagrams.close()

    def send_to(self, targets: Mapping[str, Address]) -> None:
        """Send to these from now on; by name."""
        self._targets = targets

    def _main(self) -> None:
        go_first()
        due = earliest = self._clock.now()
        while not self._ended.is_set():
            self._receive(due, earliest)
            pause = EVERY
            try:
                pause = self._send()
            except Exception:  # noqa: BLE001, it is reported
                threads.report_failure()
            now = self._clock.now()
            due, earliest = now + pause, now + _APART

    def _receive(self, until: float, earliest: float) -> None:
        """Take in what comes until a moment [s]; first of all what is there.

        What has to be answered is so at once, but not before `earliest` [s]. When more
        comes than can be read, the own heartbeat goes first.
        """
        while True:
            received = self._datagrams.receive(until)
            if received and self._hear(received):
                until = min(until, earliest)
            if self._clock.now() >= until:
                return

    def _send(self) -> float:
        beat, pause = self._next_beat()
        self._datagrams.send(beat, list(self._targets.values()))
        return pause
