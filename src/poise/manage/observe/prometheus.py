"""Gives Prometheus what it asks for over HTTP; names and values are in `metrics`."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from poise.errors import RunError
from poise.manage.control_socket.commands import RobotStatus
from poise.manage.observe.metrics import METRICS, kind_of, samples


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
    """Serves ``/metrics`` at an IP address and TCP port, until it is closed."""

    def __init__(self, collector: MetricsCollector, host: str, port: int) -> None:
        registry = CollectorRegistry()
        registry.register(collector)
        try:
            self._server, self._thread = start_http_server(port, host, registry)
        except OSError as error:
            where = f"{host}:{port}"
            raise RunError(f"metrics cannot be served on {where}: {error}") from error

    @property
    def port(self) -> int:
        """The TCP port that it listens on."""
        return int(self._server.server_address[1])

    def close(self) -> None:
        """Serve no more."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
