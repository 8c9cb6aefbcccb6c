"""Estimates and counts to an OpenTelemetry collector, over OTLP/HTTP (extra `otel`)."""

from __future__ import annotations

import logging
import threading
from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import partial

from opentelemetry.exporter.otlp.proto.http.metric_exporter import OTLPMetricExporter
from opentelemetry.metrics import CallbackOptions, Observation
from opentelemetry.sdk.metrics import MeterProvider
from opentelemetry.sdk.metrics.export import (
    MetricExportResult,
    MetricsData,
    PeriodicExportingMetricReader,
)
from opentelemetry.sdk.resources import Resource

from poise.manage.control_socket.commands import RobotStatus
from poise.manage.observe.metrics import METRICS, kind_of, samples

EVERY = 5.0
"""Metrics go out so often [s]."""
_LIMIT = 2.0
_FIRST = next(iter(METRICS))
_LOGGER = logging.getLogger(OTLPMetricExporter.__module__)
_PATH = "/v1/metrics"
_UNITS = {"cores": "{core}", "share": "1", "bytes": "By", "seconds": "s"}


class Telemetry:
    """Sends metrics, named as for Prometheus, until it is closed.

    `say`: told once that metrics do not get out, and once that they do again.
    """

    def __init__(
        self,
        robot: str,
        status: Callable[[], RobotStatus],
        endpoint: str,
        say: Callable[[str], object],
        every: float = EVERY,  # [s]; > 0
    ) -> None:
        url = endpoint.rstrip("/").removesuffix(_PATH) + _PATH
        self._provider = MeterProvider(
            metric_readers=[
                PeriodicExportingMetricReader(
                    _Exporter(url, say),
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
        self._found: dict[str, list[Observation]] = {}
        meter = self._provider.get_meter("poise")
        for name, unit, says, grows in _instruments():
            create = (
                meter.create_observable_counter
                if grows
                else meter.create_observable_gauge
            )
            create(name, [partial(self._observe, name)], unit, says)

    def close(self) -> None:
        """Send what there is, within a few seconds, and end."""
        self._provider.shutdown(1000 * _LIMIT)

    def _observe(self, metric: str, _: CallbackOptions) -> list[Observation]:
        if metric == _FIRST:  # the others are asked for after it, each time
            self._found = defaultdict(list)
            for name, labels, value in samples(self._status()):
                self._found[name].append(Observation(value, labels))
        return self._found.get(metric, [])


class _Exporter(OTLPMetricExporter):  # type: ignore[misc]  # it has no types
    """Says what OpenTelemetry logs of each failure, at the first of a series only."""

    def __init__(self, url: str, say: Callable[[str], object]) -> None:
        super().__init__(endpoint=url, timeout=_LIMIT)
        self._url = url
        self._say = say
        self._is_away = False
        self._why = ""

    def export(
        self, metrics_data: MetricsData, *args: object, **kwargs: object
    ) -> MetricExportResult:
        self._why = ""
        _LOGGER.addFilter(self._keep_reason)
        try:
            result = super().export(metrics_data, *args, **kwargs)
        finally:
            _LOGGER.removeFilter(self._keep_reason)
        is_away = result is not MetricExportResult.SUCCESS
        if is_away and not self._is_away:
            self._say(
                f"metrics do not reach {self._url}, which is tried again: {self._why}"
            )
        elif self._is_away and not is_away:
            self._say(f"metrics reach {self._url} again")
        self._is_away = is_away
        return result

    def _keep_reason(self, record: logging.LogRecord) -> bool:
        """Keep what OpenTelemetry says of this export, so that nobody else gets it."""
        if record.thread != threading.get_ident():
            return True
        self._why = self._why or record.getMessage()
        return False


def _instruments() -> Iterator[tuple[str, str, str, bool]]:
    """Yield names, units, meanings, and whether values only grow."""
    for name, says in METRICS.items():
        yield name, _unit(name), says, kind_of(name) == "counter"
        if kind_of(name) == "summary":
            yield f"{name}_sum", _unit(name), says, True
            yield f"{name}_count", "1", says, True


def _unit(name: str) -> str:
    """Return the unit as UCUM writes it, from the end of a metric's name."""
    last = name.removesuffix("_total").rpartition("_")[2]
    if name.endswith("_per_second"):
        return "By/s" if "bytes" in name else "1/s"
    return _UNITS.get(last, "1")
