"""Estimates as metrics in the text format of Prometheus, and a place to fetch them."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from poise.manage.estimates import Estimates

_HELP = {
    "poise_component_cpu_cores": "Mean CPU that a component needs, of the reference "
    "computer's cores",
    "poise_component_cpu_expected_cores": "What its profile says",
    "poise_component_cpu_p95_cores": "95th percentile over sampling windows",
    "poise_component_starved_share": "Share of its jobs that went undone",
    "poise_connector_calls_per_second": "Calls over a connector",
    "poise_connector_messages_per_second": "Messages over a connector",
    "poise_connector_bytes_per_second": "Traffic over a connector",
}
_ESCAPED = str.maketrans({"\\": r"\\", '"': r"\"", "\n": r"\n"})


def to_prometheus(estimates: Estimates) -> str:
    """Return all estimates in Prometheus' text format, version 0.0.4."""
    samples = list(_samples(estimates))
    lines = []
    for name, help_ in _HELP.items():
        lines += [f"# HELP {name} {help_}", f"# TYPE {name} gauge"]
        lines += [
            f"{name}{labels} {value!r}" for n, labels, value in samples if n == name
        ]
    return "\n".join(lines) + "\n"


def _samples(estimates: Estimates) -> Iterator[tuple[str, str, float]]:
    for each in estimates.standings():
        labels = _labels(component=each.component, computer=each.computer)
        now = each.estimate
        yield "poise_component_cpu_cores", labels, now.mean
        yield "poise_component_cpu_p95_cores", labels, now.p95
        yield "poise_component_starved_share", labels, now.starved
        if each.expected is not None:
            yield "poise_component_cpu_expected_cores", labels, each.expected
    for traffic in estimates.traffic():
        labels, flow = _labels(connector=traffic.connector), traffic.now
        yield "poise_connector_calls_per_second", labels, flow.calls
        yield "poise_connector_messages_per_second", labels, flow.messages
        yield "poise_connector_bytes_per_second", labels, flow.traffic


def _labels(**values: str) -> str:
    pairs = (f'{name}="{v.translate(_ESCAPED)}"' for name, v in values.items())
    return f"{{{','.join(pairs)}}}"


class MetricsServer:
    """Serves ``/metrics`` to Prometheus until it is closed.

    Parameters
    ----------
    address
        IP address and TCP port; port 0: any that is free.
    """

    def __init__(self, estimates: Estimates, address: tuple[str, int]) -> None:
        class Handler(BaseHTTPRequestHandler):
            timeout = 5.0

            def do_GET(self) -> None:
                """Answer one request."""
                if self.path != "/metrics":
                    self.send_error(404, "only /metrics is here")
                    return
                body = to_prometheus(estimates).encode()
                self.send_response(200)
                self.send_header("Content-Type", "text/plain; version=0.0.4")
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: object) -> None:
                """Say nothing: the terminal is the robot's."""

        self._server = ThreadingHTTPServer(address, Handler)
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
