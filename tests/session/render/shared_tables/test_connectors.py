"""How connectors are shown: each end's own numbers, and nothing where nothing was."""

from __future__ import annotations

from io import StringIO

import pytest
from msgspec.structs import replace
from rich.console import Console

from poise.session.render.tables import connector_tables, failed_calls
from poise.wire.records.status_records import ConnectorStatus, Side, Summary

NAME = "laser-of-the-robot.distances-navigator.distances"


def lines(*ends: ConnectorStatus, width: int = 80) -> list[list[str]]:
    """Return the lines of each table, so many columns wide."""
    found = []
    for rows in connector_tables(ends):
        out = StringIO()
        Console(file=out, width=width).print(rows)
        found.append(out.getvalue().splitlines())
    return found


def shown(*ends: ConnectorStatus) -> list[list[list[str]]]:
    return [[row.split() for row in rows[2:]] for rows in lines(*ends)]


def end(
    which: Side,
    messages: int,
    sizes: tuple[int, int] = (0, 0),
    errors: int = 0,
    drops: int = 0,
    *,
    name: str = "eye.x-mind.x",
) -> ConnectorStatus:
    came = messages if which == "target" else 0
    return ConnectorStatus(
        name=name,
        kind="remote",
        end=which,
        ready=True,
        wait=Summary(count=messages, median=0.001, p99=0.002),
        messages=messages,
        bytes_out=sizes[0],
        bytes_in=sizes[1],
        errors=errors,
        drops=drops,
        size=Summary(messages, 100, 100, 200, 300),
        latency=Summary(count=came, median=0.0012, p99=0.004),
        latency_error=0.0003 if came else 0.0,
    )


def test_each_direction_has_a_row() -> None:
    source = end("source", 5, (500, 0))
    target = end("target", 4, (0, 400), errors=1, drops=3)
    counts, times, sizes = shown(target, source)
    assert counts == [
        ["eye.x-mind.x"],
        ["remote", "source", "5", "500", "B"],
        ["remote", "target", "4", "400", "B", "1", "3"],
    ]
    assert times == [
        ["eye.x-mind.x"],
        ["source", "1", "ms", "2", "ms"],
        ["target", "1", "ms", "2", "ms", *["1.2", "ms", "±", "300", "µs", "4", "ms"]],
    ]
    size = ["100", "B", "200", "B", "300", "B"]
    assert sizes == [["eye.x-mind.x"], ["source", *size], ["target", *size]]


def test_on_one_computer_one_way_is_exact() -> None:
    local = ConnectorStatus(
        name="a-b",
        kind="local",
        end="source",
        ready=True,
        calls=1,
        latency=Summary(count=1, median=0.0001, p99=0.0001),
    )
    (_, times) = shown(local)
    assert times == [["a-b"], ["source", *["100", "µs", "100", "µs"]]]


def test_amid_a_move_two_targets_count_together_and_the_source_once() -> None:
    ends = [end("source", 5), end("source", 5)]
    ends += [end("target", 3), end("target", 2)]
    counts, *_ = shown(*ends)
    assert [row[-1] for row in counts[1:]] == ["5", "5"]


def test_connectors_that_carried_nothing_take_no_time() -> None:
    idle = ConnectorStatus(name="a-b", kind="direct", end="both", ready=False)
    assert shown(idle) == [[["a-b"], ["not", "joined", "both"]]]


def test_long_names_leave_the_numbers_whole() -> None:
    for rows in lines(end("target", 123_456, (0, 10**9), 12, 345, name=NAME)):
        assert NAME in rows
        cells = [row for row in rows if "target" in row]
        assert len(cells) == 1, rows
        assert max(map(len, rows)) <= 80
        assert "…" not in "".join(rows)


def test_says_over_which_connectors_calls_failed() -> None:
    calls = ConnectorStatus(
        name="ask", kind="direct", end="both", ready=True, calls=2000, errors=1500
    )
    served = replace(calls, end="target")
    fine = replace(calls, name="other", errors=0)
    assert [*failed_calls([served, fine, calls])] == [
        "ask: 1,500 of 2,000 calls failed"
    ]


@pytest.mark.parametrize("width", [1, 8, 12, 60])
def test_no_terminal_is_too_narrow(width: int) -> None:
    for rows in lines(end("target", 123_456, (0, 10**9), 12, 345), width=width):
        assert max(map(len, rows)) <= width


def test_a_figure_that_is_cut_ends_in_an_ellipsis() -> None:
    counts, *_ = lines(end("target", 123_456, (0, 10**9)), width=40)
    assert "…" in counts[-1]
