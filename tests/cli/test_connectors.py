"""How connectors are shown: each end's own numbers, and nothing where nothing was."""

from __future__ import annotations

from io import StringIO

from rich.console import Console

from poise.cli.connectors import connector_table
from poise.wire.messages import ConnectorStatus, End, Summary


def shown(*ends: ConnectorStatus) -> list[list[str]]:
    out = StringIO()
    Console(file=out, width=120).print(connector_table(ends))
    _, _, *rows = out.getvalue().splitlines()
    return [row.split() for row in rows]


def end(
    which: End,
    messages: int,
    sizes: tuple[int, int] = (0, 0),
    errors: int = 0,
    drops: int = 0,
) -> ConnectorStatus:
    return ConnectorStatus(
        name="eye.x-mind.x",
        kind="remote",
        end=which,
        ready=True,
        wait=Summary(count=messages, median=0.001, p99=0.002),
        messages=messages,
        bytes_out=sizes[0],
        bytes_in=sizes[1],
        errors=errors,
        drops=drops,
    )


def test_each_direction_has_a_row() -> None:
    source = end("source", 5, (500, 0))
    target = end("target", 4, (0, 400), errors=1, drops=3)
    assert shown(target, source) == [
        ["eye.x-mind.x", "remote", "source", "5", "500", "B", "1", "ms", "2", "ms"],
        ["target", "4", "400", "B", "1", "3", "1", "ms", "2", "ms"],
    ]


def test_amid_a_move_two_targets_count_together_and_the_source_once() -> None:
    ends = [end("source", 5), end("source", 5)]
    ends += [end("target", 3), end("target", 2)]
    rows = shown(*ends)
    assert [row[-5] for row in rows] == ["5", "5"]
