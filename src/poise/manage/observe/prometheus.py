"""Gives Prometheus what it asks for over HTTP; names and values are in `metrics`."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable
from typing import Any, Self

from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from poise.endpoint import is_loopback
from poise.errors import RunError
from poise.manage.control_socket.commands import RobotStatus
from poise.manage.observe.metrics import METRICS, kind_of, samples

_LOOK_EVERY = 0.1


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
        values = {
            (name, *labels.items()): (name, labels, value)
            for name, labels, value in samples(self._status())
        }
        for name, labels, value in values.values():
            family = families[str(name).removesuffix("_sum").removesuffix("_count")]
            family.add_sample(str(name), dict(labels), value)
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
        while (error := self._listen(host, port)) is not None:
            if time.monotonic() >= until:
                where = f"{host}:{port}"
                raise RunError(f"metrics cannot be served on {where}: {error}")
            time.sleep(_LOOK_EVERY)

    def _listen(self, host: str, port: int) -> OSError | None:
        try:
            self._server, self._thread = start_http_server(port, host, self._registry)
        except OSError as error:
            return error
        if is_loopback(host):
            self._server.set_app(_for_this_computer(self._server.get_app()))
        return None

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


def _for_this_computer(app: Any) -> Callable[..., Any]:  # noqa: ANN401, WSGI
    def guarded(environ: dict[str, Any], start_response: Callable[..., Any]) -> Any:  # noqa: ANN401
        host = environ.get("HTTP_HOST", "")
        if host and not is_loopback(re.sub(r":\d*$", "", host)):
            start_response("403 Forbidden", [("Content-Type", "text/plain")])
            return [f"{host} is not a name of this computer\n".encode("latin-1")]
        return app(environ, start_response)

    return guarded
