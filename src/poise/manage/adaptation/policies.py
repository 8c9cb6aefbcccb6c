"""Evaluates the policies of a robot: what holds now, and for how long."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from functools import cache

from msgspec import Struct, structs

from poise.errors import PoiseError, signal_name
from poise.manage.adaptation import policy_process
from poise.manage.adaptation.policy_process import IMPORT_LIMIT, LIMIT, FunctionAnswer
from poise.manage.adaptation.when_to_act import Backoff
from poise.model.condition import Condition, parse_condition, sentence
from poise.model.policy import (
    ACTIONS,
    COOL_DOWN,
    LASTS,
    SUBJECTS,
    Policy,
    PolicyAction,
    Seen,
    Subject,
    Values,
)
from poise.waker import wait_readable
from poise.wire import frame

_AGAIN, _LONGEST = 10.0, 300.0
"""A process that ended is started again after this time [s]; then after twice that."""
_MARGIN = 0.5
"""The process has had time to end by itself, which says more [s]."""


class OwnFunction:
    """Asks a function what to do. All times are of one clock [s]."""

    def __init__(self, reference: str, folder: str) -> None:
        self._reference = reference
        self._folder = folder
        self._process: subprocess.Popen[bytes] | None = None
        self._actions: tuple[PolicyAction, ...] = ()
        self._asked_at: float | None = None
        self._limit = IMPORT_LIMIT
        self._backoff = Backoff(_AGAIN, _LONGEST)
        self.trouble = ""  # what is wrong with it, for people

    def ask(self, seen: Seen, *, waits: bool = False) -> tuple[PolicyAction, ...]:
        """Return what it said last, or with `waits` to this, and ask it again."""
        try:
            self._hear()
            self._ask(seen)
            if waits and self._asked_at is not None:
                self._wait()
                self._hear()
        except (PoiseError, OSError) as error:
            self._end(str(error), seen.at)
        return self._actions

    def close(self) -> int | None:
        """End its process; return its exit code, also of one that ended by itself."""
        process, self._process = self._process, None
        if process is None:
            return None
        process.kill()
        self._connection.close()
        return process.wait()

    def _ask(self, seen: Seen) -> None:
        if self._process is None and seen.at >= self._backoff.again_at:
            self._start()
        if self._process is None:
            return
        if self._asked_at is None:
            # much of it may wait until its module is imported
            self._writer.push(seen)
            self._asked_at = seen.at
        elif seen.at - self._asked_at > self._limit + _MARGIN:
            self._end(f"did not answer within {self._limit:g} s", seen.at)

    def _wait(self) -> None:
        """Wait until it has answered, or its time is over."""
        fd = self._connection.fileno()
        while self._writer.is_waiting and wait_readable([fd], self._limit, [fd]):
            self._writer.flush()
        wait_readable([fd], self._limit + _MARGIN)

    def _hear(self) -> None:
        if self._asked_at is None:
            return
        self._writer.flush()
        answer = self._reader.next(FunctionAnswer)
        if answer is None:
            return
        self._asked_at, self._limit = None, LIMIT
        self._actions = answer.actions
        if not answer.error:
            self._backoff.reset()
        self.trouble = answer.error and f"'{self._reference}' failed: {answer.error}"

    def _start(self) -> None:
        self._connection, theirs = socket.socketpair()
        self._reader = frame.RecordReader(self._connection)
        self._writer = frame.RecordWriter(self._connection)
        with theirs:
            words = (self._reference, self._folder, str(theirs.fileno()))
            self._process = subprocess.Popen(  # noqa: S603, our own code and Python
                [sys.executable, "-m", policy_process.__name__, *words],
                stdin=subprocess.DEVNULL,
                stdout=sys.__stderr__,  # what it prints belongs to no command's output
                pass_fds=[theirs.fileno()],
                start_new_session=True,  # Ctrl-C is for the manager
            )
        self._asked_at, self._limit = None, IMPORT_LIMIT

    def _end(self, why: str, now: float) -> None:
        """Kill its process, and start another one later."""
        self._actions, self._asked_at = (), None
        again, code = self._backoff.start(now), self.close()
        if code == -signal.SIGALRM:
            limits = f"{LIMIT:g} s, and {IMPORT_LIMIT:g} s for its import"
            why = f"took too long and was ended: its limit is {limits}"
        elif code is not None and code != -signal.SIGKILL:
            how = f"exit code {code}" if code >= 0 else signal_name(-code)
            why = f"ended its process with {how}"
        self.trouble = f"'{self._reference}' {why}; it is asked again in {again:g} s"


Key = tuple[str, str, str, str]
"""A policy, a subject, the computer where that is, and what is to be done."""
Read = Callable[[Subject], tuple[Values, ...]]
"""Returns the values of all subjects of a kind; called more than once for each."""


class Symptom(Struct, frozen=True, kw_only=True):
    """A subject for which the condition of a policy holds."""

    policy: Policy
    what: str  # a sentence for people
    values: Values  # what was seen

    @property
    def key(self) -> Key:
        """What tells it apart from others, also later."""
        return _key(self.policy, self.values)

    @property
    def computer(self) -> str:
        """Where it is; empty: nowhere in particular."""
        is_computer = self.policy.for_each == "computer"
        return self.values.name if is_computer else self.key[2]


_UNSEEN = 5.0
"""What is not reported any more counts as it was for this time [s]."""


class Policies:
    """The policies of a robot, and since when conditions hold [s, by one clock]."""

    def __init__(
        self,
        policies: Iterable[Policy],
        folder: str = "",
        components: Iterable[str] = (),  # all of the robot, also those that do not run
    ) -> None:
        self._names: set[tuple[str, str]] = {("component", name) for name in components}
        """What actions may be about: what does not run now is left as it is."""
        policies = [policy for policy in policies if not policy.off]
        self._policies = [(p, _condition(p).read) for p in policies if not p.call]
        self._functions = [(p, OwnFunction(p.call, folder)) for p in policies if p.call]
        self._acted: dict[Key, float] = {}
        self._seen_at: dict[Key, float] = {}
        self.since: Mapping[Key, float] = {}
        self.suspends: frozenset[str] = frozenset()
        """Components and containers that functions want suspended, running or not."""

    def troubles(self) -> dict[str, str]:
        """Return policy -> what is wrong with its function, for people."""
        return {
            policy.name: f"policy '{policy.name}': {function.trouble}"
            for policy, function in self._functions
            if function.trouble
        }

    def close(self) -> None:
        """End the processes of functions."""
        for _, function in self._functions:
            function.close()

    def evaluate(
        self,
        read: Read,
        now: float,
        *,
        waits: bool = False,  # for functions; else what they said last counts
        lacks_some: bool = False,  # subjects of a computer that has not reported yet
    ) -> tuple[Symptom, ...]:
        """Return the symptoms that have been there at every look for long enough."""
        read = cache(read)  # several policies look at the same subjects
        holding = {
            _key(policy, subject): (policy, subject)
            for policy, holds in self._policies
            if policy.for_each is not None
            for subject in filter(holds, read(policy.for_each))
        }
        holding |= self._by_functions(read, now, waits=waits)
        unseen = self._unseen(read, now) if lacks_some else ()
        self._seen_at |= dict.fromkeys(holding, now)
        self.since = {
            key: self.since.get(key, now) for key in dict.fromkeys([*holding, *unseen])
        }
        self._seen_at = {key: self._seen_at[key] for key in self.since}
        return tuple(
            Symptom(policy=policy, what=_what(policy, subject), values=subject)
            for key, (policy, subject) in holding.items()
            if now - self.since[key] >= _or(policy.lasts, LASTS)
        )

    def _unseen(self, read: Read, now: float) -> list[Key]:
        """Return the conditions that held lately, and whose subjects are not seen."""
        seen = {
            _key(policy, subject)
            for policy, _ in self._policies
            if policy.for_each is not None
            for subject in read(policy.for_each)
        }
        names = {policy.name for policy, _ in self._policies}  # not of functions
        return [
            key
            for key in self.since
            if key[0] in names
            and key not in seen
            and now - self._seen_at[key] <= _UNSEEN
        ]

    def _by_functions(
        self, read: Read, now: float, *, waits: bool
    ) -> dict[Key, tuple[Policy, Values]]:
        wanted, suspends = {}, set[str]()
        seen = Seen.by(read, now) if self._functions else Seen(at=now)
        for policy, function in self._functions:
            for action in function.ask(seen, waits=waits):
                whole, values = _resolved(policy, action, seen)
                if action.do == "suspend":
                    suspends.add(action.about.partition(".")[0])  # of a timer
                if values is not None:
                    self._names.add((whole.for_each or "", action.about))
                    wanted[_key(whole, values)] = whole, values
                elif self._names.isdisjoint(
                    (subject, action.about) for subject in ACTIONS[action.do]
                ):
                    text = f"'{policy.call}' names no subject '{action.about}'"
                    function.trouble = f"{text} for '{action.do}'"
        self.suspends = frozenset(suspends)
        return wanted

    def due(self, symptoms: Iterable[Symptom], now: float) -> tuple[Symptom, ...]:
        """Return the symptoms about which something may be done: none cools down."""
        return tuple(
            symptom
            for symptom in symptoms
            if now - self._acted.get(symptom.key, float("-inf"))
            >= _or(symptom.policy.cool_down, COOL_DOWN)
        )

    def note_acted(self, symptoms: Iterable[Symptom], now: float) -> None:
        """Remember that something was done about symptoms."""
        self._acted |= {symptom.key: now for symptom in symptoms}


def saw(symptoms: Iterable[Symptom]) -> list[dict[str, object]]:
    """Return policies and the values that they saw, for the journal."""
    return [
        {"policy": symptom.policy.name, "saw": symptom.values} for symptom in symptoms
    ]


def _resolved(
    policy: Policy, action: PolicyAction, seen: Seen
) -> tuple[Policy, Values | None]:
    """Return the policy as if it had been written for an action, and its subject."""
    for subject in ACTIONS[action.do]:
        for values in seen.of(subject):
            if values.name == action.about:
                whole = structs.replace(
                    policy,
                    for_each=subject,
                    do=action.do,
                    to=action.to or None,
                    by=action.by or None,
                    force=action.force,
                    say=action.why,
                )
                return whole, values
    return policy, None


def _what(policy: Policy, values: Values) -> str:
    return (policy.say or "") if policy.call else sentence(policy.say or "", values)


def _key(policy: Policy, values: Values) -> Key:
    do = policy.do or ""  # a function may want several things done about a subject
    return policy.name, values.name, getattr(values, "computer", ""), do


def _condition(policy: Policy) -> Condition:
    # `poise check` saw to it that these are there
    assert policy.for_each is not None  # noqa: S101
    return parse_condition(policy.when or "", SUBJECTS[policy.for_each])


def _or(seconds: float | None, default: float) -> float:
    return default if seconds is None else seconds
