"""The steps of an exchange, by hand."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from msgspec import structs

from poise.manage.deploy.deployment_layout import DeploymentLayout
from poise.manage.deploy.desired import Incarnation
from poise.manage.migration.migration_rounds import IDLE_LIMIT, MigrationRounds
from poise.model.robot import (
    Architecture,
    ComponentEntry,
    Connector,
    ConnectorEnd,
    Robot,
)
from poise.wire.records.migration_records import Step

GATEWAYS = {"left": "10.0.0.1:4001", "right": "10.0.0.2:4002"}


def rounds_of(
    robot: Robot,
    olds: dict[str, str],
    news: dict[str, str],
    lossy: Mapping[str, int] = {},
    away: Collection[str] = (),
    /,
    **others: str,
) -> MigrationRounds:
    """Return the rounds when all components call over ports named ``calls``."""

    def placed(where: dict[str, str], epoch: int) -> tuple[Incarnation, ...]:
        return tuple(
            Incarnation(component=n, computer=c, epoch=epoch) for n, c in where.items()
        )

    rest = {each.component: each for each in placed(others, 0)}
    calls = {(component.name, "calls") for component in robot.components()}
    layout = DeploymentLayout(robot, "/run")
    sources, targets = placed(olds, 0), placed(news, 1)
    return MigrationRounds(
        layout, sources, targets, rest, calls, GATEWAYS, lossy=lossy, away=away
    )


def steps(
    round_: list[tuple[Incarnation, Step]],
) -> list[tuple[str, Step]]:
    return [(where.component, step) for where, step in round_]


def test_a_move_takes_one_round_in_stages(robot: Robot) -> None:
    rounds = rounds_of(
        robot,
        {"filter": "left"},
        {"filter": "right"},
        grabber="left",
        heavy="left",
        thinker="right",
    )
    (only,) = rounds.pause_and_transfer()
    assert steps(only) == [
        ("grabber", Step("buffer", connectors=("grabber.raw-filter.raw",))),
        ("filter", Step("pause", "filter", 0)),
        ("filter", Step("drain channels", "filter", 0, ("grabber.raw-filter.raw",))),
        ("heavy", Step("drain channels", "heavy", 0, ("filter.clean-heavy.clean",))),
        (
            "thinker",
            Step("drain channels", "thinker", 0, ("filter.clean-thinker.seen",)),
        ),
        ("filter", Step("send state", "filter", 0)),
        ("filter", Step("restore state", "filter", 1)),
        ("filter", Step("activate", "filter", 1)),
    ]


def test_a_target_asks_for_the_state_while_its_source_works(robot: Robot) -> None:
    rounds = rounds_of(robot, {"filter": "left"}, {"filter": "right"}, grabber="left")
    sources = {"filter": (0, f"{GATEWAYS['left']}/eye")}
    assert steps(rounds.prepare()) == [
        ("filter", Step("offer state", "filter", 0)),
        ("filter", Step("pre-copy", "filter", 1, sources=sources)),
        ("filter", Step("request state", "filter", 1)),
        ("filter", Step("await idle", "filter", 0, limit=IDLE_LIMIT)),
    ]


def test_no_marker_goes_over_a_cut_link(robot: Robot) -> None:
    """What `thinker` keeps is one message; it takes no more, and waits for none."""
    rounds = rounds_of(
        robot,
        {"filter": "left"},
        {"filter": "middle"},
        {"filter.clean-thinker.seen": 1},
        heavy="left",
        thinker="right",
    )
    (only,) = rounds.pause_and_transfer()
    lossy = {"filter.clean-thinker.seen/0.0": 1}
    heavy = ("filter.clean-heavy.clean",)
    assert steps(only)[:3] == [
        ("filter", Step("pause", "filter", 0, lossy=lossy)),
        ("heavy", Step("drain channels", "heavy", 0, heavy)),
        ("thinker", Step("drain channels", "thinker", 0, lossy=lossy)),
    ]


def test_a_sender_that_is_cut_off_buffers_what_would_be_kept(robot: Robot) -> None:
    rounds = rounds_of(
        robot,
        {"filter": "right"},
        {"filter": "middle"},
        {"grabber.raw-filter.raw": 4},
        grabber="left",
    )
    (only,) = rounds.pause_and_transfer()
    lossy = {"grabber.raw-filter.raw/0.0": 4}
    assert steps(only)[:3] == [
        ("grabber", Step("buffer", lossy=lossy)),
        ("filter", Step("pause", "filter", 0)),
        ("filter", Step("drain channels", "filter", 0, lossy=lossy)),
    ]


def test_a_computer_that_is_out_of_reach_takes_no_step(robot: Robot) -> None:
    lossy = {"grabber.raw-filter.raw": 1, "filter.clean-thinker.seen": 1}
    rounds = rounds_of(
        robot,
        {"filter": "right"},
        {"filter": "middle"},
        lossy,
        ["left"],
        grabber="left",
        thinker="left",
    )
    taking = [*rounds.pause_and_transfer()[0], *rounds.resume(), *rounds.roll_back()]
    assert {where.component for where, _ in taking} == {"filter"}


def test_either_side_resumes(robot: Robot) -> None:
    rounds = rounds_of(robot, {"filter": "left"}, {"filter": "right"}, grabber="left")
    assert steps(rounds.resume()) == [
        ("filter", Step("resume", "filter", 1)),
        ("filter", Step("redirect", "filter", 0)),
        (
            "grabber",
            Step("release to targets", keys=("grabber.raw-filter.raw/0.1",)),
        ),
    ]
    assert steps(rounds.roll_back()) == [
        ("filter", Step("roll back", "filter", 0)),
        (
            "grabber",
            Step("release to sources", keys=("grabber.raw-filter.raw/0.0",)),
        ),
    ]


def _alternatives() -> Robot:
    """Return a robot whose ``source`` is joined to ``a`` (then ``b``), or to ``c``."""

    def architecture(name: str, function: str, *names: str) -> Architecture:
        components = tuple(
            ComponentEntry(name=n, implementation=f"x:{n}") for n in names
        )
        return Architecture(name=name, function=function, components=components)

    def joined(first: str, second: str) -> Connector:
        ends = (ConnectorEnd(*each.split(".")) for each in (first, second))
        return Connector(between=(next(ends), next(ends)))

    return Robot(
        name="either",
        architectures=(
            architecture("ends", "ends", "source", "sink"),
            architecture("two", "it", "a", "b"),
            architecture("one", "it", "c"),
        ),
        connectors=(
            joined("source.calls", "a.port"),
            joined("a.out", "b.in"),
            joined("b.out", "sink.in"),
            joined("source.calls", "c.port"),
            joined("c.out", "sink.in"),
        ),
    )


def test_an_architecture_is_drained_on_the_way_of_its_messages() -> None:
    where = {"source": "left", "sink": "left"}
    rounds = rounds_of(
        _alternatives(), {"b": "left", "a": "left"}, {"c": "left"}, **where
    )
    first, last = (steps(each) for each in rounds.pause_and_transfer())
    assert first == [
        ("source", Step("buffer", connectors=("source.calls-a.port",))),
        ("a", Step("drain channels", "a", 0, ("source.calls-a.port",))),
        ("a", Step("drain mailbox", "a", 0)),
        ("a", Step("pause", "a", 0)),
    ]
    assert last[:3] == [
        ("b", Step("drain channels", "b", 0, ("a.out-b.in",))),
        ("b", Step("drain mailbox", "b", 0)),
        ("b", Step("pause", "b", 0)),
    ]
    assert [step for _, step in last][-2:] == [
        Step("restore state", "c", 1),
        Step("activate", "c", 1),
    ]


def test_the_alternatives_of_a_connector_share_a_slot() -> None:
    robot = _alternatives()
    layout = DeploymentLayout(robot, "/run")
    slots = {str(each): layout.slot_of(each) for each in robot.connectors}
    assert slots["source.calls-c.port"] == slots["source.calls-a.port"]
    # what comes from different components is not the same
    assert slots["c.out-sink.in"] != slots["b.out-sink.in"]


def test_what_was_buffered_for_one_goes_to_the_alternative() -> None:
    where = {"source": "left", "sink": "left"}
    rounds = rounds_of(
        _alternatives(), {"a": "left", "b": "left"}, {"c": "left"}, **where
    )
    releases = [step for _, step in rounds.resume() if step.keys]
    assert releases == [Step("release to targets", keys=("source.calls-c.port/0.1",))]
    joins = [step for _, step in rounds.prepare() if step.name == "pre-copy"]
    sources = {"a": (0, "two"), "b": (0, "two")}
    assert joins == [Step("pre-copy", "c", 1, sources=sources)]
    # who is replaced is drained, and not waited for until it happens to be idle
    assert "await idle" not in {step.name for _, step in rounds.prepare()}


def test_what_goes_to_one_only_is_not_buffered_for_the_alternative() -> None:
    """No way leads to the alternative, so it would never go out."""
    robot = _alternatives()
    ends = ConnectorEnd("sink", "calls"), ConnectorEnd("a", "more")
    robot = structs.replace(
        robot, connectors=(*robot.connectors, Connector(between=ends))
    )
    where = {"source": "left", "sink": "left"}
    rounds = rounds_of(robot, {"a": "left", "b": "left"}, {"c": "left"}, **where)
    first, *_ = rounds.pause_and_transfer()
    buffers = [each for each in steps(first) if each[1].name == "buffer"]
    assert buffers == [("source", Step("buffer", connectors=("source.calls-a.port",)))]
    assert "sink" not in {name for name, _ in steps(rounds.roll_back())}
