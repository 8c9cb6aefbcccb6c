"""What a collector of OpenTelemetry receives, over HTTP, as protobuf."""

from __future__ import annotations

import gzip
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest

from poise.manage.control_socket.commands import RobotStatus
from poise.manage.observe.estimates import Estimates
from poise.model.robot import Robot
from poise.wire.records.status_records import (
    AgentStatus,
    ConnectorStatus,
    ContainerStatus,
    Summary,
)
from tests.manage.observe.conftest import Sampler, status_of
from tests.waiting import wait_until

pytest.importorskip("opentelemetry.sdk")

from opentelemetry.proto.collector.metrics.v1.metrics_service_pb2 import (
    ExportMetricsServiceRequest,
)

from poise.manage.observe.opentelemetry import Telemetry

LIMIT = 20.0
ENDS = ConnectorStatus(
    name="eye.x-mind.x",
    kind="local",
    end="source",
    ready=True,
    messages=7,
    bytes_out=9,
    latency=Summary(7, 0.002, 0.001, 0.004, 0.005),
    latency_error=0.0003,
)
STATUSES = {
    "a": AgentStatus(
        computer="a",
        generation=1,
        uptime=1.0,
        cpu=1.0,
        containers=(ContainerStatus(name="see", pid=1, connectors=(ENDS,)),),
    )
}


class Collector:
    """A collector of OpenTelemetry's that keeps what comes."""

    def __init__(self) -> None:
        self.requests: list[Any] = []
        self.came = threading.Event()
        self.answer = 200
        collector = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                if self.headers.get("Content-Encoding") == "gzip":
                    body = gzip.decompress(body)
                assert self.path == "/v1/metrics"
                request = ExportMetricsServiceRequest()
                request.ParseFromString(body)
                collector.requests.append(request)
                collector.came.set()
                self.send_response(collector.answer)
                self.send_header("Content-Type", "application/x-protobuf")
                self.send_header("Content-Length", "0")
                self.end_headers()

            def log_message(self, *_: object) -> None: ...

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.thread = threading.Thread(target=self.server.serve_forever)
        self.thread.start()
        self.url = f"http://127.0.0.1:{self.server.server_address[1]}"

    def close(self) -> None:
        self.server.shutdown()
        self.thread.join(LIMIT)
        self.server.server_close()


@pytest.fixture(name="collector")
def _collector() -> Iterator[Collector]:
    collector = Collector()
    yield collector
    collector.close()


@pytest.fixture(name="estimates")
def _estimates(robot: Robot, steady: Sampler) -> Estimates:
    estimates = Estimates(robot, None, emulated=True)
    for k in range(50):
        estimates.add(steady(0.2 * k))
    return estimates


def points(request: Any) -> dict[str, dict[tuple[str, ...], float]]:
    """Return metric -> the values of its labels -> its value."""
    found: dict[str, dict[tuple[str, ...], float]] = {}
    for resource in request.resource_metrics:
        for scope in resource.scope_metrics:
            for metric in scope.metrics:
                data = metric.gauge if metric.HasField("gauge") else metric.sum
                found[metric.name] = {
                    tuple(sorted(a.value.string_value for a in point.attributes)): (
                        point.as_double
                        if point.HasField("as_double")
                        else float(point.as_int)
                    )
                    for point in data.data_points
                }
    return found


@pytest.mark.slow
def test_a_collector_gets_what_prometheus_gets(
    collector: Collector, estimates: Estimates
) -> None:
    telemetry = Telemetry(
        "r", lambda: status_of(estimates, STATUSES), collector.url, print, 0.1
    )
    try:
        assert collector.came.wait(LIMIT)
    finally:
        telemetry.close()
    found = points(collector.requests[0])
    assert found["poise_component_cpu_cores"] == pytest.approx(
        {("a", "eye"): 0.1, ("a", "mind"): 0.2}
    )
    assert found["poise_connector_messages_per_second"] == pytest.approx(
        {("eye.x-mind.x",): 10}
    )
    assert found["poise_connector_messages_total"] == {
        ("a", "eye.x-mind.x", "source"): 7
    }
    assert found["poise_connector_bytes_total"] == {
        ("a", "eye.x-mind.x", "out", "source"): 9,
        ("a", "eye.x-mind.x", "in", "source"): 0,
    }
    assert found["poise_connector_latency_seconds"] == {
        ("0.5", "a", "eye.x-mind.x", "source"): 0.001,
        ("0.99", "a", "eye.x-mind.x", "source"): 0.004,
        ("1", "a", "eye.x-mind.x", "source"): 0.005,
    }
    end = "a", "eye.x-mind.x", "source"
    assert found["poise_connector_latency_seconds_count"] == {end: 7}
    assert found["poise_connector_latency_seconds_sum"] == pytest.approx(
        {end: 7 * 0.002}
    )
    assert found["poise_connector_latency_error_seconds"] == {
        ("a", "eye.x-mind.x", "source"): 0.0003
    }
    attributes = collector.requests[0].resource_metrics[0].resource.attributes
    names = {each.key: each.value.string_value for each in attributes}
    assert (names["service.name"], names["service.instance.id"]) == ("poise", "r")


@pytest.mark.slow
def test_a_robot_is_looked_at_once_for_all_its_metrics(
    collector: Collector, estimates: Estimates
) -> None:
    looks: list[int] = []

    def look() -> RobotStatus:
        looks.append(1)
        return status_of(estimates, STATUSES)

    telemetry = Telemetry("r", look, collector.url, print, 0.1)
    wait_until(lambda: len(collector.requests) > 2)
    telemetry.close()
    assert len(looks) == len(collector.requests)
    for request in collector.requests:
        assert points(request) == points(collector.requests[0])


@pytest.mark.slow
def test_what_is_left_goes_out_at_the_end(
    collector: Collector, estimates: Estimates
) -> None:
    telemetry = Telemetry(
        "r",
        lambda: status_of(estimates, {}),
        f"{collector.url}/v1/metrics",
        print,
        3600.0,
    )
    telemetry.close()
    assert "poise_component_cpu_cores" in points(collector.requests[-1])


@pytest.mark.slow
def test_a_collector_that_is_away_is_no_error(
    collector: Collector, estimates: Estimates
) -> None:
    away = Telemetry(
        "r", lambda: status_of(estimates, {}), "http://127.0.0.1:9", print, 3600.0
    )
    away.close()
    assert collector.requests == []


@pytest.mark.slow
def test_a_collector_that_refuses_is_said_once_and_so_is_its_return(
    collector: Collector, estimates: Estimates, caplog: pytest.LogCaptureFixture
) -> None:
    said: list[str] = []
    collector.answer = 500
    telemetry = Telemetry(
        "r", lambda: status_of(estimates, {}), collector.url, said.append, 0.05
    )
    try:
        wait_until(lambda: len(collector.requests) > 3)
        collector.answer = 200
        wait_until(lambda: len(said) > 1)
    finally:
        telemetry.close()
    url = f"{collector.url}/v1/metrics"
    away, back = said
    assert away.startswith(f"metrics do not reach {url}, which is tried again: ")
    assert "500" in away
    assert back == f"metrics reach {url} again"
    assert caplog.messages == []
