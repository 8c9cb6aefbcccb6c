"""What a component used and did: the CPU time of its thread, its waits and its jobs."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable

from poise.runtime.mailbox import Inbox
from poise.runtime.sampler import ThreadWait
from poise.runtime.schedule import Schedule
from poise.wire.messages import ComponentSpec
from poise.wire.samples import ComponentSample


class Account:
    """Counts for one incarnation of a component; `begin` says for which thread."""

    def __init__(self) -> None:
        self._cpu_clock: int | None = None
        self._cpu_at_end = 0.0
        self._thread = 0
        self._wait = ThreadWait()
        self._waited = self._sampled_cpu = 0.0
        self._done = 0

    def begin(self) -> None:
        """Count for this thread from now on."""
        # asked for here: of a thread that has ended, it must not be asked for
        self._cpu_clock = time.pthread_getcpuclockid(threading.get_ident())
        self._thread = threading.get_native_id()

    def end(self) -> None:
        """Count no more: this thread is about to end."""
        self._cpu_at_end = time.thread_time()
        self._cpu_clock = None

    def note_done(self) -> None:
        """Count a job that was ended."""
        self._done += 1

    def cpu(self) -> float:
        """Return the CPU time of the thread so far [s]."""
        clock = self._cpu_clock
        if clock is None:
            return self._cpu_at_end
        try:
            return time.clock_gettime(clock)
        except OSError:  # it ended between the two lines
            return self._cpu_at_end

    def sample(
        self,
        spec: ComponentSpec,
        asked: int,
        called: float,
        served: int,
    ) -> ComponentSample:
        """Return the counters now; called on one thread only.

        Parameters
        ----------
        asked
            How many jobs came (`jobs_asked`).
        called
            What calls add to the thread's CPU time [s] (`attribution.called_cpu`).
        served
            How many calls it has answered: they are its jobs when it has no others.
        """
        done = self._done
        if not asked:
            asked = done = served
        cpu = self.cpu() + called
        # a system call, for those whose jobs do not tell whether they keep up
        if self._cpu_clock is not None and not asked and cpu != self._sampled_cpu:
            self._waited = self._wait.read(self._thread)
        self._sampled_cpu = cpu
        return ComponentSample(spec.name, spec.epoch, cpu, self._waited, asked, done)


def jobs_asked(
    schedules: Iterable[Schedule], inboxes: Iterable[Inbox], now: float
) -> int:
    """Return how many releases and messages there were until `now` [s]."""
    return sum(s.asked(now) for s in schedules) + sum(i.arrived for i in inboxes)
