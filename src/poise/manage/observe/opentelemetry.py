"""Estimates and counts to an OpenTelemetry collector, over OTLP/HTTP (extra `otel`)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from opentelemetry.exporter.otlp.proto.http.metric_exporter import OTLPMetricExporter
from opentelemetry.metrics import CallbackOptions, Observation
from opentelemetry.sdk.metrics import MeterProvider
from opentelemetry.sdk.metrics.export import PeriodicExportingMetricReader
from opentelemetry.sdk.resources import Resource

from poise.manage.control_socket.commands import RobotStatus
from poise.manage.observe.metrics import METRICS, kind_of, samples

EVERY = 5.0
"""Metrics go out so often [s]."""
_LIMIT = 2.0
_PATH = "/v1/metrics"
_UNITS = {"cores": "{core}", "share": "1", "bytes": "By", "seconds": "s"}


class Telemetry:
    """Sends metrics until it is closed; a collector that is away is no error.

    Names and labels are those that Prometheus gets.

    `status`: returns the last known state; any thread may call it.
    """

    def __init__(
        self,
        robot: str,
        status: Callable[[], RobotStatus],
        endpoint: str,
        every: float = EVERY,  # [s]; > 0
    ) -> None:
        url = endpoint.rstrip("/").removesuffix(_PATH) + _PATH
        self._provider = MeterProvider(
            metric_readers=[
                PeriodicExportingMetricReader(
                    OTLPMetricExporter(endpoint=url, timeout=_LIMIT),
                    export_interval_millis=1000 * every,
                    export_timeout_millis=1000 * _LIMIT,
                )
            ],
            resource=Resource.create(
                {"service.name": "poise", "service.instance.id": robot}
            ),
            shutdown_on_exit=False,
        )
        self._status = status
        meter = self._provider.get_meter("poise")
        for name, says in METRICS.items():
            # quantiles come from the connectors' ends: here they are gauges
            create = (
                meter.create_observable_counter
                if kind_of(name) == "counter"
                else meter.create_observable_gauge
            )
            create(name, [partial(self._observe, name)], _unit(name), says)

    def close(self) -> None:
        """Send what there is, within a few seconds, and end."""
        self._provider.shutdown(1000 * _LIMIT)

    def _observe(self, metric: str, _: CallbackOptions) -> list[Observation]:
        found = {
            tuple(labels.items()): Observation(value, labels)
            for name, labels, value in samples(self._status())
            if name == metric
        }
        return list(found.values())


def _unit(name: str) -> str:
    """Return the unit as UCUM writes it, from the end of a metric's name."""
    last = name.removesuffix("_total").rpartition("_")[2]
    if name.endswith("_per_second"):
        return "By/s" if "bytes" in name else "1/s"
    return _UNITS.get(last, "1")
