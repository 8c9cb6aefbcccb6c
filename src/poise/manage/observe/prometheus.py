"""Gives Prometheus what it asks for over HTTP; names and values are in `metrics`."""

from __future__ import annotations

import contextlib
import re
import socket
import time
from collections.abc import Callable, Iterable
from socketserver import ThreadingMixIn
from typing import Any, Self
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

from prometheus_client import CollectorRegistry, make_wsgi_app
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from poise import threads
from poise.endpoint import is_loopback
from poise.errors import RunError
from poise.manage.control_socket.commands import RobotStatus
from poise.manage.observe.metrics import METRICS, kind_of, samples
from poise.wire.address import family_of

_LOOK_EVERY = 0.1
MOST_CLIENTS = 32
"""So many requests are served at a time; a further one ends the oldest."""


class MetricsCollector(Collector):
    """Reads all metrics; `status` returns the robot's, on any thread."""

    def __init__(self, status: Callable[[], RobotStatus]) -> None:
        self._status = status

    def collect(self) -> Iterable[Metric]:
        """Return the metrics with their present values."""
        families = {
            name: Metric(name.removesuffix("_total"), meaning, kind_of(name))
            for name, meaning in METRICS.items()
        }
        for name, labels, value in samples(self._status()):
            family = families[name.removesuffix("_sum").removesuffix("_count")]
            family.add_sample(name, dict(labels), value)
        return families.values()


class MetricsServer:
    """Serves ``/metrics`` at an IP address and TCP port, until it is closed.

    On loopback, a request must name this computer: a page that a browser has from
    another site could read the metrics under that site's name.

    `patience`: for so long who listens there may take to end [s].
    """

    def __init__(self, host: str, port: int, patience: float = 0.0) -> None:
        self._registry = CollectorRegistry()
        until = time.monotonic() + patience
        while True:
            try:
                self._server = _Server(host, port)
                break
            except OSError as error:
                if time.monotonic() >= until:
                    where = f"{host}:{port}"
                    text = f"metrics cannot be served on {where}: {error}"
                    raise RunError(text) from error
            time.sleep(_LOOK_EVERY)
        app: Any = make_wsgi_app(self._registry)
        self._server.set_app(_for_this_computer(app) if is_loopback(host) else app)
        self._thread = threads.daemon(self._server.serve_forever, "metrics")
        self._thread.start()

    def show(self, status: Callable[[], RobotStatus]) -> None:
        """Serve what `status` returns, on any thread; there was nothing before."""
        self._registry.register(MetricsCollector(status))

    @property
    def port(self) -> int:
        """The TCP port that it listens on."""
        return int(self._server.server_address[1])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Serve no more."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Server(ThreadingMixIn, WSGIServer):
    """Serves at most `MOST_CLIENTS` requests at a time, each on its own thread."""

    daemon_threads = True
    request_queue_size = 128

    def __init__(self, host: str, port: int) -> None:
        self.address_family = family_of(host)
        self._open: dict[Any, None] = {}
        super().__init__((host, port), _Handler)

    def process_request(self, request: Any, client_address: Any) -> None:  # noqa: ANN401, as socketserver has it
        """Serve a request; if there are too many, the oldest ends."""
        if len(self._open) >= MOST_CLIENTS:
            oldest = next(iter(self._open))
            self._open.pop(oldest, None)
            with contextlib.suppress(OSError):  # it has just ended
                oldest.shutdown(socket.SHUT_RDWR)
        self._open[request] = None
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:  # noqa: ANN401, as above
        """End a request."""
        self._open.pop(request, None)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:  # noqa: ANN401, as above
        """Say nothing of a client that has left: any could fill the log."""


class _Handler(WSGIRequestHandler):
    def get_environ(self) -> dict[str, Any]:
        """Return what was asked; always for text, for the library fails on others."""
        environ = super().get_environ()
        environ.pop("HTTP_ACCEPT", None)
        return environ

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002, its name there
        """Log no requests."""


def _for_this_computer(app: Any) -> Callable[..., Any]:  # noqa: ANN401, WSGI
    def guarded(environ: dict[str, Any], start_response: Callable[..., Any]) -> Any:  # noqa: ANN401
        host = environ.get("HTTP_HOST", "")
        if host and not is_loopback(re.sub(r":\d*$", "", host)):
            start_response("403 Forbidden", [("Content-Type", "text/plain")])
            return [f"{host} is not a name of this computer\n".encode("latin-1")]
        return app(environ, start_response)

    return guarded
