"""What a robot's policies would have done in a run that was recorded."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from msgspec import Struct

from poise.errors import UsageError
from poise.manage.adaptation.policies import Policies
from poise.manage.observe.sample_recording import unpacked
from poise.model.policy.policy import Do, Values
from poise.model.policy.shipped import policies_of
from poise.model.robot import Robot
from poise.session.callbacks import Say, log
from poise.wire.recording_file import load


class PolicyEvent(Struct, frozen=True, kw_only=True):
    """Something that a policy would have done.

    Parameters
    ----------
    at
        When [s], since the recording began.
    policy, do
        The policy's name, and its action.
    about, computer
        The subject, and where it was.
    what
        A sentence for people.
    saw
        The values of the subject.
    """

    at: float
    policy: str
    do: Do | None
    about: str
    computer: str
    what: str
    saw: Values


def test_policies(
    robot: Robot,
    recording: str | PathLike[str],
    *,
    say: Say = log.info,  # noqa: PT028, it is no test
) -> tuple[PolicyEvent, ...]:
    """Return what the policies of a robot would have done, without acting.

    It replays the values that were seen, so what an action would have changed does not
    show: a policy acts again after each cool-down while its condition holds. Whether a
    new placement would have been worth its moves is not computed.

    Parameters
    ----------
    recording
        A file of `poise up --record`.
    say
        Takes what is wrong with policies' own functions.

    Raises
    ------
    UsageError
        It cannot be read, or nothing that policies see was recorded.
    """
    recorded = load(Path(recording))
    if not recorded.seen:
        raise UsageError(
            f"nothing that policies see is recorded in {recording}: "
            "`poise up --record` records it"
        )
    policies = Policies(policies_of(robot), robot.folder)
    found: list[PolicyEvent] = []
    began: float | None = None
    troubles: set[str] = set()
    try:
        for packed in recorded.seen:
            seen = unpacked(packed)
            began = seen.at if began is None else began
            due = policies.due(policies.look(seen.of, seen.at, waits=True), seen.at)
            policies.note_acted(due, seen.at)
            for trouble in set(policies.troubles()) - troubles:
                say(trouble)
                troubles.add(trouble)
            found += [
                PolicyEvent(
                    at=seen.at - began,
                    policy=each.policy.name,
                    do=each.policy.do,
                    about=each.values.name,
                    computer=each.computer,
                    what=each.what,
                    saw=each.values,
                )
                for each in due
            ]
    finally:
        policies.close()
    return tuple(found)


test_policies.__test__ = False  # type: ignore[attr-defined] # no test, if pytest sees it
