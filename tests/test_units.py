"""Quantities as people write them, read into SI and written back."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from poise.units import (
    BANDWIDTH,
    BYTES,
    CORES,
    DIMENSIONS,
    NUMBER,
    RATE,
    RATIO,
    SECONDS,
    Dimension,
    format_amount,
    format_bandwidth,
    format_bytes,
    format_cores,
    format_seconds,
    named,
    parse,
    quoted,
)


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [
        ("20%", CORES, 0.2),
        ("1.5", CORES, 1.5),
        ("1.5 cores", CORES, 1.5),
        ("1 core", CORES, 1.0),
        (3, CORES, 3.0),
        ("512 MiB", BYTES, 512 * 1024**2),
        ("512MiB", BYTES, 512 * 1024**2),
        ("3 kB", BYTES, 3000.0),
        ("1 GiB", BYTES, 1024**3),
        ("200 ms", SECONDS, 0.2),
        ("5 µs", SECONDS, 5e-6),
        ("5 \u03bcs", SECONDS, 5e-6),
        ("2 min", SECONDS, 120.0),
        ("10 Hz", RATE, 10.0),
        ("3 1/s", RATE, 3.0),
        ("100 Mbit/s", BANDWIDTH, 12.5e6),
        ("100 Mbps", BANDWIDTH, 12.5e6),
        ("12.5 MB/s", BANDWIDTH, 12.5e6),
        ("1 GiB/s", BANDWIDTH, 1024**3),
        ("5%", RATIO, 0.05),
        ("1e3", NUMBER, 1000.0),
        (".5", NUMBER, 0.5),
        (" 7 ", NUMBER, 7.0),
    ],
)
def test_reads_what_people_write_into_si(
    text: str, dimension: Dimension, value: float
) -> None:
    assert parse(text, dimension) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "dimension", "words"),
    [
        ("nan", NUMBER, ["'nan'", "is not a number"]),
        ("inf", BYTES, ["'inf'", "is not a size", "512 MiB", "KiB"]),
        ("-1 s", SECONDS, ["'-1 s'", "negative"]),
        ("-0", NUMBER, ["'-0'", "negative"]),
        ("1e999", NUMBER, ["'1e999'", "too large"]),
        ("512 mb", BYTES, ["'512 mb'", "unit 'mb'", "did you mean 'MB'?", "GiB"]),
        ("10 Hz", SECONDS, ["'10 Hz'", "unit 'Hz'", "time", "ms"]),
        ("5%", SECONDS, ["unit '%'"]),
        ("", NUMBER, ["''", "is not a number such as 2"]),
        ("two", CORES, ["'two'", "number of cores", "20% or 1.5 cores"]),
        ("1_000", NUMBER, ["unknown unit '_000'"]),
        ("9" * 5000, NUMBER, ["999...'"]),
    ],
)
def test_refuses_naming_the_value_and_what_it_takes(
    text: str, dimension: Dimension, words: list[str]
) -> None:
    with pytest.raises(ValueError, match="'") as error:
        parse(text, dimension)
    assert all(word in str(error.value) for word in words), str(error.value)
    assert len(str(error.value)) < 250


@given(st.text(), st.sampled_from(sorted(DIMENSIONS)))
def test_gives_a_finite_amount_or_a_value_error(text: str, dimension: str) -> None:
    try:
        value = parse(text, DIMENSIONS[dimension])
    except ValueError:
        return
    assert math.isfinite(value)
    assert value >= 0


@pytest.mark.parametrize(
    ("shown", "text"),
    [
        (format_cores(1.5), "1.5 cores"),
        (format_cores(1), "1 core"),
        (format_bytes(512 * 1024**2), "512 MiB"),
        (format_bytes(0), "0 B"),
        (format_bytes(1023.9999 * 1024), "1 MiB"),
        (format_seconds(0.2), "200 ms"),
        (format_seconds(0), "0 s"),
        (format_seconds(90), "90 s"),
        (format_seconds(4.2e-5), "42 µs"),
        (format_bandwidth(12.5e6), "12.5 MB/s"),
        (format_amount("cpu", 0.25), "0.25 cores"),
        (format_amount("memory", 2048), "2 KiB"),
        (format_amount("gpu", 2), "2"),
        (format_bytes(2000 * 1024**3), "2000 GiB"),
        (format_bytes(999.7 * 1024**2), "1000 MiB"),
    ],
)
def test_writes_si_for_people(shown: str, text: str) -> None:
    assert shown == text


@given(st.floats(min_value=1, max_value=1e14))
def test_a_written_size_is_read_back_to_three_digits(size: float) -> None:
    assert parse(format_bytes(size), BYTES) == pytest.approx(size, rel=6e-3)


def test_quotes_on_one_line_and_cut() -> None:
    assert quoted("a\nb") == r"'a\nb'"
    assert len(quoted("x" * 1000)) == 62


@pytest.mark.parametrize(
    ("text", "dimension", "suggestion"),
    [
        ("8 Mb/s", BANDWIDTH, "did you mean 'Mbit/s' or 'MB/s'? 1 byte B is 8 bit"),
        ("8 Gb/s", BANDWIDTH, "did you mean 'Gbit/s' or 'GB/s'?"),
        ("8 kb/s", BANDWIDTH, "did you mean 'kbit/s' or 'kB/s'?"),
        ("8 Kb/s", BANDWIDTH, "did you mean 'kbit/s' or 'kB/s'?"),
        ("8 Mib/s", BANDWIDTH, "did you mean 'Mbit/s' or 'MiB/s'?"),
        ("8 Tb/s", BANDWIDTH, "did you mean 'Tbit/s' or 'TB/s'?"),
        ("8 b/s", BANDWIDTH, "did you mean 'bit/s' or 'B/s'?"),
        ("8 mbps", BANDWIDTH, "did you mean 'Mbit/s' or 'MB/s'?"),
        ("8 MBps", BANDWIDTH, "did you mean 'MB/s' or 'Mbit/s'?"),
        ("8 Mbit", BANDWIDTH, "did you mean 'Mbit/s' or 'MB/s'?"),
        ("8 Mb", BYTES, "did you mean 'MB'? 1 byte B is 8 bit"),
        ("8 kib", BYTES, "did you mean 'KiB'?"),
        ("8 Mbit", BYTES, "did you mean 'MB'? 1 byte B is 8 bit"),
        ("8 KB", BYTES, "did you mean 'kB'?"),
        ("2 mins", SECONDS, "did you mean 'min'?"),
        ("2 Sec", SECONDS, ""),
        ("2 m", SECONDS, ""),
        ("2 MHz", RATE, ""),
        ("2 hz", RATE, "did you mean 'Hz'?"),
        ("2 coers", CORES, "did you mean 'cores'?"),
    ],
)
def test_a_suggested_unit_means_what_was_written(
    text: str, dimension: Dimension, suggestion: str
) -> None:
    with pytest.raises(ValueError, match="unknown unit") as error:
        parse(text, dimension)
    if suggestion:
        assert suggestion in str(error.value)
    else:
        assert "did you mean" not in str(error.value)


@pytest.mark.parametrize(
    ("names", "text"),
    [
        (["a"], "task 'a'"),
        (["a", "b"], "tasks 'a' and 'b'"),
        (["a", "b", "c"], "tasks 'a', 'b' and 'c'"),
    ],
)
def test_several_names_have_their_noun_in_the_plural(
    names: list[str], text: str
) -> None:
    assert named("task", names) == text
