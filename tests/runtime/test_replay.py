"""A workload is played: recorded messages, and made up ones."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from poise import Message
from poise.runtime.replay import TICK, Replay
from poise.testing import Bench
from poise.wire.codec import codec
from poise.wire.recording_file import Input
from tests.recordings import write_recording


class Text(Message):
    text: str


def words(_: object, size: float) -> Text:
    return Text("w" * int(size))


# found by name, as a robot's own types are, however pytest imported this file
sys.modules["played_texts"] = sys.modules[__name__]
TEXT = "played_texts:Text"


def recorded(path: Path, *messages: tuple[str, float, str]) -> str:
    """Write a recording of texts; return its file."""
    encode = codec(Text).encode
    inputs = [
        Input(source, at, encode(Text(text))[0], b"") for source, at, text in messages
    ]
    write_recording(path, "r", inputs)
    return str(path)


def player(**parameters: Any) -> Bench[Any]:
    parameters.setdefault("recording", "")
    return Bench(Replay.__poise_specialised__(parameters, ""), parameters)


def generated(**how: Any) -> dict[str, Any]:
    """Return what a port sends: texts, generated for some port."""
    return {"type": TEXT, "generated": {"port": {"component": "a", "port": "x"}, **how}}


def texts(bench: Bench[Any], port: str) -> list[str]:
    return [message.text for message in bench.published[port]]


def test_plays_what_each_source_published_when_it_did(tmp_path: Path) -> None:
    file = recorded(
        tmp_path / "r", ("a.x", 0.0, "one"), ("b.y", 0.2, "other"), ("a.x", 0.3, "two")
    )
    ports = {
        "first": {"type": TEXT, "sources": ["a.x"]},
        "second": {"type": TEXT, "sources": ["b.y"]},
    }
    with player(recording=file, ports=ports) as bench:
        bench.advance(0.1 + TICK)
        assert texts(bench, "first") == ["one"]
        bench.advance(0.1)
        assert texts(bench, "second") == ["other"]
        bench.advance(0.1)
        assert texts(bench, "first") == ["one", "two"]


def test_a_recording_begins_again(tmp_path: Path) -> None:
    """It lasts 0.3 s, and a pause of 0.1 s."""
    file = recorded(tmp_path / "r", ("a.x", 0.0, "one"), ("a.x", 0.3, "two"))
    ports = {"out": {"type": TEXT, "sources": ["a.x"]}}
    with player(recording=file, ports=ports) as bench:
        bench.advance(0.7 + TICK)
        assert texts(bench, "out") == ["one", "two", "one", "two"]


def test_makes_up_messages_at_a_rate_and_a_size() -> None:
    """20 Hz for 2 s; all of them have the size that was asked for."""
    ports = {"out": generated(rate=20.0, size=108.0)}
    with player(ports=ports) as bench:
        bench.advance(2 + TICK)
        sizes = [len(codec(Text).encode(each)[0]) for each in bench.published["out"]]
    assert sizes == [108] * 40


@pytest.mark.slow
def test_arrivals_may_be_random_and_are_the_same_for_a_seed() -> None:
    """1000 in 50 s on average; the standard deviation is 32."""
    found = []
    for seed in (1, 1, 2):
        part = generated(rate=20.0, arrivals="poisson", seed=seed)
        with player(ports={"out": part}) as bench:
            bench.advance(50.0)
            found.append(len(bench.published["out"]))
    assert found[0] == found[1]
    assert all(abs(count - 1000) < 4 * 32 for count in found)


def test_sizes_vary_evenly_around_the_mean() -> None:
    part = generated(rate=100.0, size=1000.0, variation=0.2)
    with player(ports={"out": part}) as bench:
        bench.advance(5.0)
        sizes = [len(text) for text in texts(bench, "out")]
    assert 780 < min(sizes) < 830
    assert 1160 < max(sizes) < 1200
    assert sum(sizes) / len(sizes) == pytest.approx(1000, abs=30)


class Odd(Message):
    text: bytearray


def odd(_: object, size: float) -> Odd:
    return Odd(bytearray(int(size)))


def test_a_function_of_the_robots_makes_what_nothing_else_can() -> None:
    part = generated(rate=10.0, size=7.0, message="played_texts:odd")
    ports = {"out": {**part, "type": "played_texts:Odd"}}
    with player(ports=ports) as bench:
        bench.advance(0.1 + TICK)
        assert [len(each.text) for each in bench.published["out"]] == [7]


def test_a_function_of_the_robots_may_make_them() -> None:
    part = generated(rate=10.0, size=7.0, message="played_texts:words")
    with player(ports={"out": part}) as bench:
        bench.advance(0.1 + TICK)
        assert texts(bench, "out") == ["wwwwwww"]
