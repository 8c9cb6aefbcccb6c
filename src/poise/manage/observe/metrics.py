"""The metrics of a running robot: one table, and their values. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Literal, get_args

from poise.manage.agent_connections.statuses import connectors_of, located
from poise.manage.control_socket.commands import RobotStatus
from poise.manage.tasks.task_reports import TaskState
from poise.wire.records.status_records import ComponentStatus, ConnectorStatus, Summary

Sample = tuple[str, Mapping[str, str], float]
"""A metric's name, its labels and its value."""

METRICS = {
    "poise_deviations": "How much of a computer is not as the robot file wants it",
    "poise_computer_lost": "1 while a computer is out of reach, else 0",
    "poise_task_state": "1 for the state of a task, as it was started last; else 0",
    "poise_timer_releases_total": "How often a timer was due",
    "poise_timer_missed_total": "Of these, ended after the deadline or skipped",
    "poise_component_cpu_cores": "Mean CPU that a component needs, of the reference "
    "computer's cores",
    "poise_component_cpu_expected_cores": "What its profile says",
    "poise_component_cpu_p95_cores": "95th percentile over sampling windows",
    "poise_component_starved_share": "Share of its jobs that lacked CPU",
    "poise_chain_age_seconds": "How old the data of a chain was when a component used "
    "it",
    "poise_chain_missed_total": "Uses of data that was older than the chain's deadline",
    "poise_connector_calls_per_second": "Calls over a connector",
    "poise_connector_messages_per_second": "Messages over a connector",
    "poise_connector_bytes_per_second": "Traffic over a connector",
    "poise_connector_calls_total": "Calls over a connector, as its end counts",
    "poise_connector_messages_total": "Messages over a connector, as its end counts",
    "poise_connector_bytes_total": "What left an end of a connector, or came to it",
    "poise_connector_errors_total": "Calls that failed, and what was refused",
    "poise_connector_drops_total": "Messages that an end of a connector gave up",
    "poise_connector_delay_seconds": "Calls: there and back, or until the answer",
    "poise_connector_wait_seconds": "Messages: until they went out, or were taken",
    "poise_connector_latency_seconds": "From the other end to this one",
    "poise_connector_size_bytes": "Calls, both ways, and messages over a wire",
    "poise_connector_latency_error_seconds": "Mean bound of the error of latencies: "
    "what is not known of the other computer's clock",
}
"""Name -> meaning. Kinds and units are at the end of names, as Prometheus has them."""
_AGE = "poise_chain_age_seconds"
_SUMMARIES = {
    "poise_connector_delay_seconds": "delay",
    "poise_connector_wait_seconds": "wait",
    "poise_connector_latency_seconds": "latency",
    "poise_connector_size_bytes": "size",
}
"""Name -> field of `ConnectorStatus`."""


def kind_of(name: str) -> Literal["counter", "gauge", "summary"]:
    """Return what kind of metric one is, in Prometheus' words."""
    if name.endswith("_total"):
        return "counter"
    return "summary" if name in {*_SUMMARIES, _AGE} else "gauge"


def samples(robot: RobotStatus) -> Iterable[Sample]:
    """Return the present values; what comes twice while a component moves, once.

    Of a computer that is out of reach come its counters as they were, and nothing that
    says how it is now.
    """
    found = {(each[0], *each[1].items()): each for each in _all_samples(robot)}
    return found.values()


def _all_samples(robot: RobotStatus) -> Iterator[Sample]:
    deviations = Counter(deviation.computer for deviation in robot.deviations)
    computers = {*robot.computers, *robot.out_of_reach, *robot.capacities}
    for computer in sorted(computers):
        is_lost = computer in robot.out_of_reach
        yield "poise_computer_lost", {"computer": computer}, int(is_lost)
    for computer in sorted(computers | deviations.keys()):
        yield "poise_deviations", {"computer": computer}, deviations[computer]
    for task, now in {report.name: report.state for report in robot.tasks}.items():
        for state in get_args(TaskState):
            yield "poise_task_state", {"task": task, "state": state}, int(state == now)
    yield from _demand_samples(robot)
    yield from _traffic_samples(robot)
    for computer, component in located(robot.computers):
        yield from _component_samples(component, computer)
    for computer, status in sorted(robot.computers.items()):
        for container in status.containers:
            for end in container.connectors:
                labels = {"connector": end.name, "end": end.end, "computer": computer}
                yield from _end_samples(labels, end)


def _demand_samples(robot: RobotStatus) -> Iterator[Sample]:
    """Yield what components need, where that is known now."""
    for demand in robot.demand_estimates:
        if demand.computer in robot.out_of_reach:
            continue
        labels = {"component": demand.component, "computer": demand.computer}
        now = demand.estimate
        yield "poise_component_cpu_cores", labels, now.mean
        yield "poise_component_cpu_p95_cores", labels, now.p95
        yield "poise_component_starved_share", labels, now.starved
        if demand.expected is not None:
            yield "poise_component_cpu_expected_cores", labels, demand.expected


def _traffic_samples(robot: RobotStatus) -> Iterator[Sample]:
    """Yield what goes over connectors, where that is known now."""
    lost = _sources(robot, is_lost=True) - _sources(robot, is_lost=False)
    for name, flow in robot.traffic.items():
        if name in lost:
            continue
        labels = {"connector": name}
        yield "poise_connector_calls_per_second", labels, flow.calls
        yield "poise_connector_messages_per_second", labels, flow.messages
        yield "poise_connector_bytes_per_second", labels, flow.traffic


def _sources(robot: RobotStatus, *, is_lost: bool) -> set[str]:
    """Return the connectors that begin on computers that are out of reach, or not."""
    return {
        end.name
        for computer, status in robot.computers.items()
        if (computer in robot.out_of_reach) == is_lost
        for end in connectors_of({computer: status})
        if end.end != "target"
    }


def _component_samples(component: ComponentStatus, computer: str) -> Iterator[Sample]:
    """Yield how its timers kept their rates, and how old the data was that it used."""
    where = {"component": component.name, "computer": computer}
    for timer in component.timers:
        labels = {**where, "timer": timer.name}
        yield "poise_timer_releases_total", labels, timer.releases
        yield "poise_timer_missed_total", labels, timer.missed
    for chain in component.chains:
        labels = {**where, "chain": chain.name}
        yield from _summary_samples(_AGE, labels, chain.age)
        if chain.deadline is not None:
            yield "poise_chain_missed_total", labels, chain.missed


def _end_samples(labels: dict[str, str], end: ConnectorStatus) -> Iterator[Sample]:
    """Yield what an end of a connector counted, and how long things took there."""
    for what in ("calls", "messages", "errors", "drops"):
        yield f"poise_connector_{what}_total", labels, getattr(end, what)
    for direction, size in (("out", end.bytes_out), ("in", end.bytes_in)):
        more = {**labels, "direction": direction}
        yield "poise_connector_bytes_total", more, size
    for name, field in _SUMMARIES.items():
        yield from _summary_samples(name, labels, getattr(end, field))
    if end.latency.count:
        yield "poise_connector_latency_error_seconds", labels, end.latency_error


def _summary_samples(
    name: str, labels: Mapping[str, str], summary: Summary
) -> Iterator[Sample]:
    if summary.count:
        yield name, {**labels, "quantile": "0.5"}, summary.median
        yield name, {**labels, "quantile": "0.99"}, summary.p99
        yield name, {**labels, "quantile": "1"}, summary.maximum
        yield f"{name}_sum", labels, summary.mean * summary.count
        yield f"{name}_count", labels, summary.count
