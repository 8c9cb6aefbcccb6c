"""Estimates and counts as metrics, and where Prometheus fetches them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from poise.errors import RunError
from poise.manage.observe.estimates import Estimates
from poise.wire.records.deployment import AgentStatus, ConnectorStatus

Statuses = Mapping[str, AgentStatus]
"""Computer -> what its agent said last."""
Labels = Mapping[str, str]
Sample = tuple[str, Labels, float]
"""A metric's name, its labels and its value."""

GAUGES = {
    "poise_component_cpu_cores": "Mean CPU that a component needs, of the reference "
    "computer's cores",
    "poise_component_cpu_expected_cores": "What its profile says",
    "poise_component_cpu_p95_cores": "95th percentile over sampling windows",
    "poise_component_starved_share": "Share of its jobs that went undone",
    "poise_connector_calls_per_second": "Calls over a connector",
    "poise_connector_messages_per_second": "Messages over a connector",
    "poise_connector_bytes_per_second": "Traffic over a connector",
}
COUNTERS = {
    "poise_connector_calls_total": "Calls over a connector, as its end counts",
    "poise_connector_messages_total": "Messages over a connector, as its end counts",
    "poise_connector_bytes_total": "What left an end of a connector, or came to it",
    "poise_connector_errors_total": "Calls that failed, and what was refused",
    "poise_connector_drops_total": "Messages that an end of a connector gave up",
}
SUMMARIES = {
    "poise_connector_delay_seconds": "Calls: there and back, or until the answer",
    "poise_connector_wait_seconds": "Messages: until they went out, or were taken",
    "poise_connector_latency_seconds": "From the other end to this one",
    "poise_connector_size_bytes": "Calls, both ways, and messages over a wire",
}
ERRORS = {
    "poise_connector_latency_error_seconds": "How far latencies are off at most, in "
    "the mean: so much is not known of the other computer's clock",
}
_ESCAPED = str.maketrans({"\\": r"\\", '"': r"\"", "\n": r"\n"})


def to_prometheus(estimates: Estimates, statuses: Statuses) -> str:
    """Return estimates and counts in Prometheus' text format, version 0.0.4."""
    lines = _family(GAUGES, "gauge", gauges(estimates))
    lines += _family(COUNTERS, "counter", counters(statuses))
    lines += _family(SUMMARIES, "summary", summaries(statuses))
    lines += _family(ERRORS, "gauge", errors(statuses))
    return "\n".join(lines) + "\n"


def _family(
    helps: Mapping[str, str], kind: str, samples: Iterable[Sample]
) -> list[str]:
    # while a component moves, an end may be told of twice
    values = {(name, _text(labels)): value for name, labels, value in samples}
    lines = []
    for name, help_ in helps.items():
        lines += [f"# HELP {name} {help_}", f"# TYPE {name} {kind}"]
        lines += [
            f"{full}{labels} {value!r}"
            for (full, labels), value in values.items()
            if full.removesuffix("_sum").removesuffix("_count") == name
        ]
    return lines


def _ends(statuses: Statuses) -> Iterator[tuple[dict[str, str], ConnectorStatus]]:
    for computer, status in sorted(statuses.items()):
        for container in status.containers:
            for each in container.connectors:
                names = {"connector": each.name, "end": each.end, "computer": computer}
                yield names, each


def counters(statuses: Statuses) -> Iterator[Sample]:
    """Yield what every end of every connector counted."""
    for labels, end in _ends(statuses):
        yield "poise_connector_calls_total", labels, end.calls
        yield "poise_connector_messages_total", labels, end.messages
        yield "poise_connector_errors_total", labels, end.errors
        yield "poise_connector_drops_total", labels, end.drops
        for direction, size in (("out", end.bytes_out), ("in", end.bytes_in)):
            yield (
                "poise_connector_bytes_total",
                {**labels, "direction": direction},
                size,
            )


def summaries(statuses: Statuses) -> Iterator[Sample]:
    """Yield how long things took at every end of every connector, and their sizes."""
    for labels, end in _ends(statuses):
        found = end.delay, end.wait, end.latency, end.size
        for name, summary in zip(SUMMARIES, found, strict=True):
            if summary.count:
                for quantile, value in (
                    ("0.5", summary.median),
                    ("0.99", summary.p99),
                    ("1", summary.maximum),
                ):
                    yield name, {**labels, "quantile": quantile}, value
                yield f"{name}_sum", labels, summary.mean * summary.count
                yield f"{name}_count", labels, summary.count


def errors(statuses: Statuses) -> Iterator[Sample]:
    """Yield how far latencies between computers are off at most."""
    (name,) = ERRORS
    for labels, end in _ends(statuses):
        if end.latency.count:
            yield name, labels, end.latency_error


def gauges(estimates: Estimates) -> Iterator[Sample]:
    """Yield what components need and what goes over connectors now."""
    for each in estimates.demand_estimates():
        labels = {"component": each.component, "computer": each.computer}
        now = each.estimate
        yield "poise_component_cpu_cores", labels, now.mean
        yield "poise_component_cpu_p95_cores", labels, now.p95
        yield "poise_component_starved_share", labels, now.starved
        if each.expected is not None:
            yield "poise_component_cpu_expected_cores", labels, each.expected
    for traffic in estimates.traffic():
        labels, flow = {"connector": traffic.connector}, traffic.now
        yield "poise_connector_calls_per_second", labels, flow.calls
        yield "poise_connector_messages_per_second", labels, flow.messages
        yield "poise_connector_bytes_per_second", labels, flow.traffic


def _text(labels: Labels) -> str:
    pairs = (f'{name}="{v.translate(_ESCAPED)}"' for name, v in labels.items())
    return f"{{{','.join(pairs)}}}"


class MetricsServer:
    """Serves ``/metrics`` to Prometheus until it is closed.

    Parameters
    ----------
    statuses
        Returns what every agent said last; any thread may call it.
    address
        IP address and TCP port; port 0: any that is free.

    Raises
    ------
    RunError
        The address cannot be had.
    """

    def __init__(
        self,
        estimates: Estimates,
        statuses: Callable[[], Statuses],
        address: tuple[str, int],
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
        self._thread = threading.Thread(
            target=self._server.serve_forever, name="metrics", daemon=True
        )
        self._thread.start()

    @property
    def port(self) -> int:
        """The TCP port that it listens on."""
        return int(self._server.server_address[1])

    def close(self) -> None:
        """Serve no more."""
        self._server.shutdown()
        self._server.server_close()
