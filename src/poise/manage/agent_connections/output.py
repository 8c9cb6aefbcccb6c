"""Reads what components wrote, on all computers."""

from __future__ import annotations

from msgspec.structs import replace

from poise.manage.agent_connections.agents import Agents
from poise.manage.control_socket.records import LogCommand, LogReading
from poise.wire.records.output import OutputLines, ReadOutput

_LIMIT = 1.0


def read_log(agents: Agents, command: LogCommand) -> LogReading:
    """Return what was written after the moments of a command; from any thread."""
    asked = {
        computer: ReadOutput(
            component=command.component,
            after=command.after.get(computer, 0),
            most=command.most,
        )
        for computer in agents.statuses()
    }
    answers = agents.ask_all(asked, _LIMIT)
    after, lines, omitted = dict(command.after), [], 0
    for computer, answer in answers.items():
        if isinstance(answer, OutputLines):
            lines += [replace(line, computer=computer) for line in answer.lines]
            omitted += answer.omitted
            if answer.lines:
                after[computer] = answer.lines[-1].at
    lines.sort(key=lambda line: line.at)
    last = lines[-command.most :]
    silent = [c for c, each in answers.items() if not isinstance(each, OutputLines)]
    omitted += len(lines) - len(last)
    return LogReading(tuple(last), after, omitted, tuple(sorted(silent)))
