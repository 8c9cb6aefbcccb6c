"""Sends and takes heartbeats: datagrams, on a thread that goes first.

No connection: after a cut, TCP may be silent for longer than the cut lasted, and one
lost packet holds back all that come after it.
"""

from __future__ import annotations

import logging
import socket
import threading
from collections.abc import Callable, Mapping

import msgspec

from poise import threads
from poise.clock import Clock
from poise.endpoint import Endpoint
from poise.priority import go_first
from poise.wire.failure_detector import EVERY
from poise.wire.records.heartbeats import Heartbeat

log = logging.getLogger(__name__)

_LARGEST = 16384
_JOIN_LIMIT = 1.0
_READING = 0.02
"""What waits is read for this time at most [s]: far more than the kernel holds."""
Address = tuple[str, int]


class Heartbeats:
    """A thread that sends one heartbeat to all every `EVERY`, and takes what comes.

    Parameters
    ----------
    hear
        Called with each heartbeat, where it came from, and when [s]; returns whether to
        send one at once.
    next_beat
        Called before each sending, when all that came was heard; returns what is sent,
        and how long to wait for the next time [s].
    listen
        Where; None: anywhere.
    """

    def __init__(
        self,
        clock: Clock,
        hear: Callable[[Heartbeat, Address, float], bool],
        next_beat: Callable[[], tuple[Heartbeat, float]],
        listen: Endpoint | None = None,
        *,
        is_ipv6: bool = False,
    ) -> None:
        self._clock = clock
        self._hear = hear
        self._next_beat = next_beat
        self._targets: Mapping[str, Address] = {}
        family = socket.AF_INET6 if is_ipv6 else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        if listen is not None:
            try:
                self._socket.bind((listen.host, listen.port))
            except OSError:
                self._socket.close()
                raise
        self._ended = threading.Event()
        self._decode = msgspec.msgpack.Decoder(Heartbeat).decode
        self._thread = threads.daemon(self._main, "heartbeats", again=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def close(self) -> None:
        """End."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join(_JOIN_LIMIT)
        self._socket.close()

    def send_to(self, targets: Mapping[str, Address]) -> None:
        """Send to these from now on; by name."""
        self._targets = targets

    def _main(self) -> None:
        go_first()
        due = self._clock.now()
        while not self._ended.is_set():
            self._take(due)
            try:
                due = self._clock.now() + self._send()
            except Exception:  # noqa: BLE001, it is reported
                threads.report_failure()
                due = self._clock.now() + EVERY

    def _take(self, until: float) -> None:
        """Take in what comes until a moment [s]; first of all what is there.

        When more comes than can be read, the own heartbeat goes first.
        """
        now = self._clock.now()
        most = max(until, now + _READING)
        while now < most:
            left = until - now
            self._socket.settimeout(max(left, 1e-6))
            try:
                data, source = self._socket.recvfrom(_LARGEST)
            except TimeoutError:
                return
            except OSError:  # what an earlier datagram met on its way
                if left <= 0:
                    return
                now = self._clock.now()
                continue
            now = self._clock.now()
            try:
                beat = self._decode(data)
            except msgspec.DecodeError:  # not of this version
                continue
            if self._hear(beat, source[:2], now):
                return

    def _send(self) -> float:
        beat, pause = self._next_beat()
        data = msgspec.msgpack.encode(beat)
        for address in list(self._targets.values()):
            try:
                self._socket.sendto(data, address)
            except OSError:  # a cut link: the silence says it
                continue
        return pause
