import contextlib
import socket
import struct
import threading
import urllib.error
import urllib.request
from pathlib import Path

import msgspec
import pytest
from prometheus_client import CollectorRegistry, generate_latest

from poise.errors import RunError, UsageError
from poise.estimate.profiles import (
    ComponentProfile,
    ConnectorProfile,
    Distribution,
    Profile,
)
from poise.manage.control_socket.commands import RobotStatus
from poise.manage.observe.deviations import Deviation
from poise.manage.observe.estimates import Estimates
from poise.manage.observe.prometheus import (
    MOST_CLIENTS,
    MetricsCollector,
    MetricsServer,
)
from poise.manage.observe.sample_recording import Recording
from poise.manage.tasks.task_reports import TaskReport, TaskState
from poise.model.robot import Robot
from poise.wire.recording_file import samples_of
from poise.wire.records.status_records import (
    AgentSample,
    AgentStatus,
    ComponentSample,
    ComponentStatus,
    ConnectorStatus,
    ContainerSample,
    ContainerStatus,
    Summary,
    TimerStatus,
)
from tests.manage.observe.conftest import Sampler, status_of
from tests.recordings import write_recording
from tests.waiting import wait_until


def test_stands_against_the_profile(robot: Robot, steady: Sampler) -> None:
    """The computer's 10 % are 5 % of the reference computer's core."""
    known = ComponentProfile(version="", cpu=Distribution(mean=0.05))
    profile = Profile(
        robot="r",
        poise="",
        computer="a",
        speed=0.5,
        at="",
        seconds=1.0,
        components={"eye": known},
    )
    estimates = Estimates(robot, profile, emulated=False)
    drifts = [d for k in range(200) for d in estimates.add(steady(0.2 * k))]
    assert drifts == []
    eye, mind = estimates.demand_estimates()
    assert (eye.component, eye.computer, eye.expected) == ("eye", "a", 0.05)
    assert eye.estimate.mean == pytest.approx(0.05)
    assert mind.expected is None
    assert mind.estimate.mean == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("busy", "container", "starved"),
    [
        (0.3, 0.02, 0.0),
        (0.46, 0.02, 0.9),  # of half a core: that is what an emulated one has
        (0.3, 0.95, 0.9),  # the interpreter
        (None, 0.02, 0.9),  # nobody counts what the computer uses
    ],
)
def test_who_waits_for_a_device_is_not_starved(
    robot: Robot,
    steady: Sampler,
    busy: float | None,
    container: float,
    starved: float,
) -> None:
    """Of 100 messages a second it takes 10, for 1 ms each; the others make room."""
    estimates = Estimates(robot, None, emulated=True)
    for k in range(50):
        at = 0.2 * k
        sample = steady(at)
        eye = ComponentSample("eye", 0, 0.01 * at, 0.0, round(100 * at), round(10 * at))
        inside = msgspec.structs.replace(
            sample.containers[0], components=(eye,), cpu=container * at
        )
        estimates.add(
            msgspec.structs.replace(
                sample,
                containers=(inside,),
                busy=None if busy is None else busy * at,
            )
        )
    (found,) = estimates.demand_estimates()
    assert found.estimate.starved == pytest.approx(starved, abs=0.01)
    needs = 0.1 if starved else 0.01
    assert found.estimate.mean == pytest.approx(needs, rel=0.05)


def test_a_command_on_a_slow_computer_may_be_starved(
    robot: Robot, steady: Sampler
) -> None:
    """It runs half of the time, and waits for the CPU in the other half."""
    estimates = Estimates(robot, None, emulated=False)
    for k in range(20):
        at = 0.2 * k
        sample = steady(at)
        eye = ComponentSample("eye", 0, 0.5 * at, 0.5 * at, 0, 0)
        container = msgspec.structs.replace(sample.containers[0], components=(eye,))
        estimates.add(msgspec.structs.replace(sample, containers=(container,)))
    (found,) = estimates.demand_estimates()
    assert found.estimate.mean == pytest.approx(0.25)
    assert found.estimate.is_least
    assert found.estimate.starved == 1.0


def test_time_of_an_emulated_computer_is_the_references(
    robot: Robot, steady: Sampler
) -> None:
    estimates = Estimates(robot, None, emulated=True)
    for k in range(20):
        estimates.add(steady(0.2 * k))
    assert estimates.demand_estimates()[0].estimate.mean == pytest.approx(0.1)


def test_estimates_traffic(robot: Robot, steady: Sampler) -> None:
    estimates = Estimates(robot, None, emulated=True)
    for k in range(50):
        estimates.add(steady(0.2 * k))
    assert estimates.traffic().keys() == {"eye.x-mind.x"}
    traffic = estimates.traffic()["eye.x-mind.x"]
    assert traffic.messages == pytest.approx(10)
    assert traffic.size == 500


def test_a_connector_that_falls_silent_has_no_traffic(
    robot: Robot, steady: Sampler
) -> None:
    """The other end, where nothing is ever counted, has no say in it."""
    estimates = Estimates(robot, None, emulated=True)
    silent = msgspec.structs.replace(
        steady(0.0).containers[0].connectors[0], messages=0, bytes_out=0
    )
    rates = set()
    for k in range(100):
        (here,) = steady(min(0.2 * k, 10.0)).containers
        there = msgspec.structs.replace(here, name="other", connectors=(silent,))
        both = tuple(msgspec.structs.replace(c, at=0.2 * k) for c in (here, there))
        sample = msgspec.structs.replace(steady(0.2 * k), containers=both)
        estimates.add(sample)
        rates |= {round(t.messages) for t in estimates.traffic().values()}
    assert rates == {10, 0}
    (traffic,) = estimates.traffic().values()
    assert traffic.rate == 0


def test_a_connector_whose_ends_have_ended_has_no_traffic(
    robot: Robot, steady: Sampler
) -> None:
    """First the container of both ends ends, later only one of two connectors."""
    estimates = Estimates(robot, None, emulated=True)
    for k in range(50):
        estimates.add(steady(0.2 * k))
    nothing = msgspec.structs.replace(steady(10.0), containers=())
    estimates.add(msgspec.structs.replace(nothing, computer="b"))
    assert estimates.traffic()
    estimates.add(nothing)
    assert estimates.traffic() == {}
    for k in range(50, 100):
        estimates.add(steady(0.2 * k))
    assert estimates.traffic()
    (container,) = steady(20.0).containers
    alone = msgspec.structs.replace(container, connectors=())
    estimates.add(msgspec.structs.replace(steady(20.0), containers=(alone,)))
    assert estimates.traffic() == {}


def test_a_replay_gives_the_same_estimates(
    robot: Robot, steady: Sampler, tmp_path: Path
) -> None:
    live, recording = Estimates(robot, None, emulated=True), Recording()
    for k in range(100):
        live.add(steady(0.2 * k))
        recording.add(steady(0.2 * k))
    write_recording(tmp_path / "run.mcap", "r", recording.drain())
    again = Estimates(robot, None, emulated=True)
    for sample in samples_of(tmp_path / "run.mcap"):
        again.add(sample)
    assert again.demand_estimates() == live.demand_estimates()
    assert recording.drain() == []


def test_says_what_is_no_recording(tmp_path: Path) -> None:
    (tmp_path / "x").write_text("hello")
    with pytest.raises(UsageError, match="is not a recording"):
        list(samples_of(tmp_path / "x"))
    with pytest.raises(UsageError, match="cannot be read"):
        list(samples_of(tmp_path / "y"))


def to_prometheus(status: RobotStatus) -> str:
    registry = CollectorRegistry()
    registry.register(MetricsCollector(lambda: status))
    return generate_latest(registry).decode()


def test_speaks_to_prometheus(robot: Robot, steady: Sampler) -> None:
    estimates = Estimates(robot, None, emulated=True)
    for k in range(20):
        estimates.add(steady(0.25 * k))
    text = to_prometheus(status_of(estimates, {}))
    lines = [x for x in text.splitlines() if x.startswith("poise_component_cpu_cores{")]
    labels, values = zip(*(line.split(" ") for line in lines), strict=True)
    assert labels == tuple(
        f'poise_component_cpu_cores{{component="{name}",computer="a"}}'
        for name in ("eye", "mind")
    )
    assert [float(value) for value in values] == pytest.approx([0.1, 0.2])


def test_tells_prometheus_what_each_end_counts(robot: Robot) -> None:
    target = ConnectorStatus(
        name="eye.x-mind.x",
        kind="remote",
        end="target",
        ready=True,
        messages=7,
        bytes_in=350,
        drops=2,
        wait=Summary(count=4, mean=0.5, median=0.25, p99=2.0, maximum=2.0),
    )
    container = ContainerStatus(name="see", pid=7, connectors=(target, target))
    status = AgentStatus(
        computer="a", generation=1, uptime=1.0, cpu=0.0, containers=(container,)
    )
    known = status_of(Estimates(robot, None, emulated=True), {"a": status})
    text = to_prometheus(known)
    at, end = 'computer="a",connector="eye.x-mind.x"', 'end="target"'
    assert text.count(f"poise_connector_messages_total{{{at},{end}}} 7.0\n") == 1
    assert f"poise_connector_drops_total{{{at},{end}}} 2.0\n" in text
    assert f'poise_connector_bytes_total{{{at},direction="in",{end}}} 350.0\n' in text
    assert f'poise_connector_wait_seconds{{{at},{end},quantile="0.99"}} 2.0\n' in text
    assert f"poise_connector_wait_seconds_sum{{{at},{end}}} 2.0\n" in text
    assert f"poise_connector_wait_seconds_count{{{at},{end}}} 4.0\n" in text
    assert "poise_connector_delay_seconds{" not in text  # there were no calls


def test_tells_prometheus_what_is_wrong(robot: Robot) -> None:
    """Computer b is out of reach, and on a something is not as it should be."""
    timer = TimerStatus(
        name="tick",
        period=0.1,
        deadline=0.1,
        releases=50,
        missed=3,
        lateness=Summary(),
        duration=Summary(),
    )
    eye = ComponentStatus(name="eye", epoch=0, state="active", timers=(timer,))
    container = ContainerStatus(name="see", pid=7, components=(eye,))
    agent = AgentStatus(
        computer="a", generation=1, uptime=1.0, cpu=0.0, containers=(container,)
    )
    known = status_of(Estimates(robot, None, emulated=True), {"a": agent})
    wrong = Deviation(what="container 'x' runs on 'a'", computer="a", since=0.0)
    states: tuple[tuple[str, TaskState], ...] = (
        ("go", "failed"),
        ("go", "done"),
        ("say", "failed"),
    )
    tasks = tuple(
        TaskReport(name=name, state=state, priority=0, why="", began=0.0, since=0.0)
        for name, state in states
    )
    text = to_prometheus(
        msgspec.structs.replace(
            known, out_of_reach={"b": 1.0}, deviations=(wrong,), tasks=tasks
        )
    )
    for line in (
        'poise_task_state{state="failed",task="go"} 0.0',
        'poise_task_state{state="done",task="go"} 1.0',
        'poise_task_state{state="failed",task="say"} 1.0',
        'poise_deviations{computer="a"} 1.0',
        'poise_deviations{computer="b"} 0.0',
        'poise_computer_lost{computer="a"} 0.0',
        'poise_computer_lost{computer="b"} 1.0',
        'poise_timer_releases_total{component="eye",computer="a",timer="tick"} 50.0',
        'poise_timer_missed_total{component="eye",computer="a",timer="tick"} 3.0',
    ):
        assert f"{line}\n" in text


def test_tells_prometheus_nothing_of_now_where_a_computer_is_lost(
    robot: Robot, steady: Sampler
) -> None:
    estimates = Estimates(robot, None, emulated=True)
    for k in range(20):
        estimates.add(steady(0.25 * k))
    source = ConnectorStatus(
        name="eye.x-mind.x", kind="local", end="source", ready=True
    )
    container = ContainerStatus(name="see", pid=7, connectors=(source,))
    agent = AgentStatus(
        computer="a", generation=1, uptime=1.0, cpu=0.0, containers=(container,)
    )
    traffic = {"eye.x-mind.x": ConnectorProfile(messages=10.0)}
    known = msgspec.structs.replace(status_of(estimates, {"a": agent}), traffic=traffic)
    lost = msgspec.structs.replace(known, out_of_reach={"a": 1.0})
    for now in (
        "component_cpu_cores",
        "component_starved_share",
        "messages_per_second",
    ):
        assert f"{now}{{" in to_prometheus(known)
        assert f"{now}{{" not in to_prometheus(lost)
    assert "connector_messages_total{" in to_prometheus(lost)


@pytest.mark.slow
def test_serves_metrics(robot: Robot, steady: Sampler) -> None:
    estimates = Estimates(robot, None, emulated=True)
    for k in range(3):
        estimates.add(steady(0.25 * k))
    status = status_of(estimates, {})
    with MetricsServer("127.0.0.1", 0) as server:
        server.show(lambda: status)
        at = f"http://127.0.0.1:{server.port}/metrics"
        with urllib.request.urlopen(at, timeout=20) as answer:
            assert answer.read().decode() == to_prometheus(status)


@pytest.mark.slow
@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "[", "[::2]"])
def test_metrics_on_loopback_are_refused_under_another_name(host: str) -> None:
    with MetricsServer("127.0.0.1", 0) as server:
        at = f"http://127.0.0.1:{server.port}/metrics"
        request = urllib.request.Request(at, headers={"Host": host})
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(request, timeout=20)
        for name in ("localhost", "[::1]:9464"):
            request = urllib.request.Request(at, headers={"Host": name})
            urllib.request.urlopen(request, timeout=20).close()


@pytest.mark.slow
def test_clients_that_ask_nothing_leave_room_for_others() -> None:
    with MetricsServer("127.0.0.1", 0) as server, contextlib.ExitStack() as opened:
        address, threads = ("127.0.0.1", server.port), threading.active_count()
        for _ in range(3 * MOST_CLIENTS):
            client = opened.enter_context(socket.create_connection(address, 20))
            client.sendall(b"GET /metrics HTTP/1.1\r\nHo")
        url = f"http://127.0.0.1:{server.port}/metrics"
        urllib.request.urlopen(url, timeout=20).close()
        wait_until(lambda: threading.active_count() <= threads + MOST_CLIENTS)


@pytest.mark.slow
def test_clients_write_nothing_into_the_log(capfd: pytest.CaptureFixture[str]) -> None:
    with MetricsServer("127.0.0.1", 0) as server:
        address = "127.0.0.1", server.port
        at = f"http://127.0.0.1:{server.port}/metrics"
        accept = "application/openmetrics-text;version=a;escaping=b"
        with socket.create_connection(address) as client:
            client.sendall(b"GET /metrics HTTP/1.1\r\n")
            at_once = struct.pack("ii", 1, 0)
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, at_once)
        request = urllib.request.Request(at, headers={"Accept": accept})
        urllib.request.urlopen(request, timeout=20).close()
        threads = [t for t in threading.enumerate() if "process_request" in t.name]
        for thread in threads:
            thread.join(20)
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_metrics_where_somebody_else_listens_name_the_address() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(RunError, match=f"on 127.0.0.1:{port}: .* in use"):
            MetricsServer("127.0.0.1", port)


def sample_of(
    computer: str, at: float, *incarnations: tuple[int, float]
) -> AgentSample:
    """Return a sample of `eye`; `incarnations`: epochs, with their CPU time."""
    components = [
        ComponentSample("eye", epoch, cpu, 0.0, 0, 0) for epoch, cpu in incarnations
    ]
    containers = [
        ContainerSample(f"{c.epoch}", 9, at, c.cpu, 0, (c,), ()) for c in components
    ]
    return AgentSample(computer, at, 0.0, tuple(containers))


@pytest.mark.parametrize("is_known_idle", [True, False])
@pytest.mark.parametrize("target", ["a", "b"])
def test_a_move_that_is_rolled_back_leaves_the_estimate_with_its_source(
    robot: Robot, target: str, *, is_known_idle: bool
) -> None:
    estimates = Estimates(robot, None, emulated=True)
    for k in range(30):
        at, source = 0.2 * k, (0, 0.02 * k)
        if k == 10 and is_known_idle:
            estimates.idle = {("eye", 1)}
        is_moving = 10 <= k < 20
        here = [(1, 0.05 * k)] if is_moving else []
        if target == "a":
            estimates.add(sample_of("a", at, source, *here))
        else:
            estimates.add(sample_of("a", at, source))
            estimates.add(sample_of("b", at, *here))
        if is_moving and is_known_idle:
            assert estimates.demand_estimates()[0].computer == "a"
    for k in range(30, 130):  # it needs 40 % from now on
        estimates.add(sample_of("a", 0.2 * k, (0, 0.6 + 0.08 * (k - 30))))
    (known,) = estimates.demand_estimates()
    assert known.computer == "a"
    assert known.estimate.mean > 0.3  # it was 17 % on average before


def moved(sample: AgentSample, cpu: float) -> AgentSample:
    """Return a sample whose components are incarnations that begin with `cpu` [s]."""
    (container,) = sample.containers
    components = tuple(
        msgspec.structs.replace(each, epoch=1, cpu=cpu + each.cpu)
        for each in container.components
    )
    container = msgspec.structs.replace(container, components=components)
    return msgspec.structs.replace(sample, containers=(container,))


@pytest.mark.parametrize("cpu", [-5.0, 0.0, 100.0])
def test_a_move_is_no_drift(robot: Robot, steady: Sampler, cpu: float) -> None:
    """Whatever the new incarnation's counters begin with."""
    estimates = Estimates(robot, None, emulated=True)
    drifts = [d for k in range(100) for d in estimates.add(steady(0.2 * k))]
    drifts += [
        d for k in range(100, 200) for d in estimates.add(moved(steady(0.2 * k), cpu))
    ]
    assert drifts == []
    assert estimates.demand_estimates()[0].estimate.mean == pytest.approx(0.1)
