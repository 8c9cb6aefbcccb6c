"""Errors of components' code are journalled once while they go on."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from poise.manage.observe.troubles import QUIET, CodeErrors
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ConnectorStatus,
    ContainerStatus,
    ErrorCount,
    State,
)

TEXT = 'Traceback:\n  File "hand.py", line 3\nValueError: too wide\n'
WHAT = (
    "'tick' of component 'hand' on 'left' raised ValueError: too wide; "
    "`poise log hand` says more"
)


def statuses(
    count: int, state: State = "active", pid: int = 1, *, refused: int = 0
) -> dict[str, AgentStatus]:
    error = ErrorCount(where="tick", text=TEXT, first=1.0, count=count)
    errors = (error,) if count else ()
    hand = ComponentStatus(name="hand", state=state, error_counts=errors)
    name = "eye.size-hand.size"
    end = ConnectorStatus(
        name=name, kind="local", end="target", ready=True, refused=refused
    )
    container = ContainerStatus(
        name="arm", pid=pid, components=(hand,), connectors=(end,)
    )
    status = AgentStatus(
        computer="left", generation=1, cpu=0.0, uptime=1.0, containers=(container,)
    )
    return {"left": status}


def test_what_poise_refuses_was_not_raised() -> None:
    text = "a value of type function cannot cross a connector"
    error = ErrorCount(where="checkpoint", text=text, first=1.0, count=1)
    (container,) = (status := statuses(0)["left"]).containers
    hand = replace(container.components[0], error_counts=(error,))
    said = list[str]()
    raised = CodeErrors(lambda _, what: said.append(what))
    raised.record({"left": status}, 0.0)
    container = replace(container, components=(hand,))
    raised.record({"left": replace(status, containers=(container,))}, 1.0)
    what = f"'checkpoint' of component 'hand' on 'left': {text}"
    assert said == [f"{what}; `poise log hand` says more"]


def test_says_once_that_errors_come_and_once_that_they_are_over() -> None:
    said = list[tuple[str, str]]()
    raised = CodeErrors(lambda kind, what: said.append((kind, what)))
    raised.record(statuses(0), 0.0)
    assert not said
    for now in range(1, 6):
        raised.record(statuses(3 * now), float(now))
    assert said == [("wrong", WHAT)]
    raised.record(statuses(15), 5.0 + 0.9 * QUIET)
    assert len(said) == 1
    raised.record(statuses(15), 5.0 + QUIET)
    raised.record(statuses(15), 6.0 + QUIET)
    assert said[1:] == [("right", f"no more: {WHAT} (15 times)")]


def test_what_a_restarted_component_raises_is_new() -> None:
    said = list[tuple[str, str]]()
    raised = CodeErrors(lambda kind, what: said.append((kind, what)))
    raised.record(statuses(5), 0.0)
    for now in (1.0, 2.0, 2 * QUIET):
        raised.record(statuses(2, pid=2), now)
    assert [kind for kind, _ in said] == ["wrong", "right"]
    assert said[1][1].endswith("(7 times)")


def test_what_is_out_of_reach_for_a_while_raised_nothing_new() -> None:
    said = list[tuple[str, str]]()
    raised = CodeErrors(lambda kind, what: said.append((kind, what)))
    raised.record(statuses(5), 0.0)
    raised.record({}, QUIET)
    raised.record(statuses(5), QUIET + 1)
    assert [kind for kind, _ in said] == ["wrong", "right"]


def test_a_component_that_failed_is_told_of_as_a_deviation() -> None:
    said = list[tuple[str, str]]()
    raised = CodeErrors(lambda kind, what: said.append((kind, what)))
    raised.record(statuses(1, "failed"), 0.0)
    assert not said


def test_what_was_raised_before_it_failed_is_not_new_when_it_works_again() -> None:
    said = list[tuple[str, str]]()
    raised = CodeErrors(lambda kind, what: said.append((kind, what)))
    raised.record(statuses(1, "failed"), 0.0)
    raised.record(statuses(1), 1.0)
    assert not said
    raised.record(statuses(2), 2.0)
    assert said == [("wrong", WHAT)]


def test_messages_that_are_refused_are_told_of() -> None:
    said = list[tuple[str, str]]()
    errors = CodeErrors(lambda kind, what: said.append((kind, what)))
    for now, count in enumerate((0, 3, 4, 2)):
        errors.record(statuses(0, refused=count), float(now))
    errors.record(statuses(0, refused=2), 3.0 + QUIET)
    what = (
        "connector 'eye.size-hand.size' refused messages on 'left': "
        "not of the port's type; `poise log` says more"
    )
    assert said == [
        ("wrong", what),
        ("right", f"no more: {what} (6 times)"),
    ]


def test_what_an_earlier_manager_has_told_of_is_not_new() -> None:
    said = list[tuple[str, str]]()
    raised = CodeErrors(lambda kind, what: said.append((kind, what)))
    raised.record(statuses(5, refused=2), 0.0, are_known=True)
    raised.record(statuses(5, refused=2), 1.0)
    assert not said
    raised.record(statuses(6, refused=2), 2.0)
    assert said == [("wrong", WHAT)]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("ValueError: too wide\nby 3 cm", "ValueError: too wide ..."),
        (f"{TEXT}by 3 cm\n    or more", "ValueError: too wide ..."),
        ('  File "a.py", line 1\n    a b\n      ^\nSyntaxError: no', "SyntaxError: no"),
    ],
)
def test_of_a_long_error_its_type_and_first_line_are_said(text: str, says: str) -> None:
    said = list[str]()
    component = ComponentStatus(
        name="hand",
        state="active",
        error_counts=(ErrorCount(where="tick", text=text, first=1.0, count=1),),
    )
    container = ContainerStatus(name="arm", pid=1, components=(component,))
    status = statuses(0)["left"]
    CodeErrors(lambda _, what: said.append(what)).record(
        {"left": replace(status, containers=(container,))}, 0.0
    )
    what = f"'tick' of component 'hand' on 'left' raised {says}"
    assert said == [f"{what}; `poise log hand` says more"]
