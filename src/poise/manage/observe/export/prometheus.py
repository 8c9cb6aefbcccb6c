"""Where Prometheus fetches the metrics of a running robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from poise import threads
from poise.errors import RunError
from poise.manage.agent_connections.statuses import Statuses
from poise.manage.observe.estimates import Estimates
from poise.manage.observe.export.metrics import METRICS, kind_of, samples

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
