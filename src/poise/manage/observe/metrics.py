"""The metrics of a running robot: one table, and their values. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Literal

from poise import threads
from poise.errors import RunError
from poise.manage.agent_connections.statuses import Statuses, located
from poise.manage.observe.estimates import Estimates
from poise.wire.records.status_records import ComponentStatus, ConnectorStatus, Summary

Sample = tuple[str, Mapping[str, str], float]
"""A metric's name, its labels and its value."""

METRICS = {
    "poise_component_cpu_cores": "Mean CPU that a component needs, of the reference "
    "computer's cores",
    "poise_component_cpu_expected_cores": "What its profile says",
    "poise_component_cpu_p95_cores": "95th percentile over sampling windows",
    "poise_component_starved_share": "Share of its jobs that went undone",
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
    "poise_connector_latency_error_seconds": "How far latencies are off at most, in "
    "the mean: so much is not known of the other computer's clock",
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


def samples(estimates: Estimates, statuses: Statuses) -> Iterator[Sample]:
    """Yield the present values; while a component moves, one may come twice."""
    for demand in estimates.demand_estimates():
        labels = {"component": demand.component, "computer": demand.computer}
        now = demand.estimate
        yield "poise_component_cpu_cores", labels, now.mean
        yield "poise_component_cpu_p95_cores", labels, now.p95
        yield "poise_component_starved_share", labels, now.starved
        if demand.expected is not None:
            yield "poise_component_cpu_expected_cores", labels, demand.expected
    for name, flow in estimates.traffic().items():
        labels = {"connector": name}
        yield "poise_connector_calls_per_second", labels, flow.calls
        yield "poise_connector_messages_per_second", labels, flow.messages
        yield "poise_connector_bytes_per_second", labels, flow.traffic
    for computer, component in located(statuses):
        yield from _chain_samples(component, computer)
    for computer, status in sorted(statuses.items()):
        for container in status.containers:
            for end in container.connectors:
                labels = {"connector": end.name, "end": end.end, "computer": computer}
                yield from _end_samples(labels, end)


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


def _chain_samples(component: ComponentStatus, computer: str) -> Iterator[Sample]:
    """Yield how old the data of chains was when a component used it."""
    for chain in component.chains:
        labels = {
            "chain": chain.name,
            "component": component.name,
            "computer": computer,
        }
        yield from _summary_samples(_AGE, labels, chain.age)
        if chain.deadline is not None:
            yield "poise_chain_missed_total", labels, chain.missed


def _summary_samples(
    name: str, labels: Mapping[str, str], summary: Summary
) -> Iterator[Sample]:
    if summary.count:
        yield name, {**labels, "quantile": "0.5"}, summary.median
        yield name, {**labels, "quantile": "0.99"}, summary.p99
        yield name, {**labels, "quantile": "1"}, summary.maximum
        yield f"{name}_sum", labels, summary.mean * summary.count
        yield f"{name}_count", labels, summary.count


_ESCAPED = str.maketrans({"\\": r"\\", '"': r"\"", "\n": r"\n"})


def to_prometheus(estimates: Estimates, statuses: Statuses) -> str:
    """Return estimates and counts in Prometheus' text format, version 0.0.4."""
    values = {(n, _text(labels)): v for n, labels, v in samples(estimates, statuses)}
    lines = []
    for name, help_ in METRICS.items():
        lines += [f"# HELP {name} {help_}", f"# TYPE {name} {kind_of(name)}"]
        lines += [
            f"{full}{labels} {value!r}"
            for (full, labels), value in values.items()
            if full.removesuffix("_sum").removesuffix("_count") == name
        ]
    return "\n".join(lines) + "\n"


def _text(labels: Mapping[str, str]) -> str:
    pairs = (f'{name}="{v.translate(_ESCAPED)}"' for name, v in labels.items())
    return f"{{{','.join(pairs)}}}"


class MetricsServer:
    """Serves ``/metrics`` to Prometheus until it is closed.

    `statuses`: returns what every agent said last; any thread may call it.
    """

    def __init__(
        self,
        estimates: Estimates,
        statuses: Callable[[], Statuses],
        address: tuple[str, int],  # IP address and TCP port; port 0: any that is free
    ) -> None:
        class Handler(BaseHTTPRequestHandler):
            timeout = 5.0

            def do_GET(self) -> None:
                """Answer one request."""
                if self.path != "/metrics":
                    self.send_error(404, "only /metrics is here")
                    return
                body = to_prometheus(estimates, statuses()).encode()
                self.send_response(200)
                self.send_header("Content-Type", "text/plain; version=0.0.4")
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: object) -> None:
                """Say nothing: the terminal is the robot's."""

        try:
            self._server = ThreadingHTTPServer(address, Handler)
        except OSError as error:
            where = "{}:{}".format(*address)
            raise RunError(f"metrics cannot be served on {where}: {error}") from error
        self._server.daemon_threads = True
        self._thread = threads.daemon(self._server.serve_forever, "metrics", again=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """The TCP port that it listens on."""
        return int(self._server.server_address[1])

    def close(self) -> None:
        """Serve no more."""
        self._server.shutdown()
        self._server.server_close()
