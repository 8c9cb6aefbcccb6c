"""Reads and writes quantities for people: `512 MiB`, `20%`, `200 ms`, `10 Hz`.

Poise uses SI: cores, bytes, seconds, 1/s, bytes/s, shares of 1. A plain number is SI.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Mapping

from msgspec import Struct

__all__ = [
    "BANDWIDTH",
    "BYTES",
    "CORES",
    "DIMENSIONS",
    "NUMBER",
    "RATE",
    "RATIO",
    "SECONDS",
    "Dimension",
    "counted",
    "format_amount",
    "format_bandwidth",
    "format_bytes",
    "format_cores",
    "format_seconds",
    "named",
    "parse",
    "quoted",
    "shortened",
]

_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(\S.*?)?\s*")
_DATA = re.compile(
    r"(?P<prefix>[kmgt]?)(?P<binary>i?)(?P<letter>b)(?:its?|ytes?)?(?:/s|ps|/sec)?",
    re.IGNORECASE,
)
_CLOSE = 0.8
"""How similar a suggested unit must be; a wrong suggestion is worse than none."""
_LONGEST = 60
"""[characters] A longer text is no quantity; messages show its beginning."""


class Dimension(Struct, frozen=True):
    """A kind of quantity and its units.

    `units` maps each unit to its factor; ``""`` is a plain number.
    """

    name: str
    units: Mapping[str, float]
    example: str

    def accepted(self) -> str:
        """Return an example and the units, for people."""
        named = ", ".join(unit for unit in self.units if unit and unit.isascii())
        return f"{self.name} such as {self.example}" + (named and f" (units: {named})")


_SIZES = {
    "B": 1.0,
    "kB": 1e3,
    "MB": 1e6,
    "GB": 1e9,
    "TB": 1e12,
    "KiB": 2.0**10,
    "MiB": 2.0**20,
    "GiB": 2.0**30,
    "TiB": 2.0**40,
}
_BITS = {
    "bit": 1 / 8,
    "kbit": 1e3 / 8,
    "Mbit": 1e6 / 8,
    "Gbit": 1e9 / 8,
    "Tbit": 1e12 / 8,
}

CORES = Dimension(
    "number of cores",
    {"": 1.0, "core": 1.0, "cores": 1.0, "%": 0.01},
    "20% or 1.5 cores",
)
BYTES = Dimension("size", {"": 1.0, **_SIZES}, "512 MiB")
SECONDS = Dimension(
    "time",
    {
        "": 1.0,
        "s": 1.0,
        "ms": 1e-3,
        "us": 1e-6,
        "µs": 1e-6,
        "\N{GREEK SMALL LETTER MU}s": 1e-6,
        "ns": 1e-9,
        "min": 60.0,
        "h": 3600.0,
    },
    "200 ms",
)
RATE = Dimension(
    "rate", {"": 1.0, "Hz": 1.0, "kHz": 1e3, "1/s": 1.0, "/s": 1.0}, "10 Hz"
)
BANDWIDTH = Dimension(
    "bandwidth",
    {
        "": 1.0,
        **{f"{unit}/s": factor for unit, factor in (_SIZES | _BITS).items()},
        **{f"{unit[:-2]}ps": factor for unit, factor in _BITS.items()},
    },
    "100 Mbit/s",
)
RATIO = Dimension("share", {"": 1.0, "%": 0.01}, "5% or 0.05")
NUMBER = Dimension("number", {"": 1.0}, "2")

DIMENSIONS = {
    d.name: d for d in (CORES, BYTES, SECONDS, RATE, BANDWIDTH, RATIO, NUMBER)
}


def parse(text: str | float, dimension: Dimension) -> float:
    """Return the quantity `text` in SI: finite and >= 0."""
    match = _QUANTITY.fullmatch(str(text)) if len(str(text)) <= _LONGEST else None
    if match is None:
        raise ValueError(f"{quoted(text)} is not a {dimension.accepted()}")
    number, unit = float(match[1]), match[2] or ""
    if unit not in dimension.units:
        raise ValueError(
            f"{quoted(text)} has the unknown unit '{unit}'"
            f"{_similar(unit, dimension)}; write a {dimension.accepted()}"
        )
    value = number * dimension.units[unit]
    if not math.isfinite(value):
        raise ValueError(f"{quoted(text)} is too large for a {dimension.name}")
    if value < 0 or match[1].startswith("-"):
        raise ValueError(f"{quoted(text)}: a {dimension.name} must not be negative")
    return value


def quoted(value: object) -> str:
    """Return `value` in quotes on one line, shortened if it is long."""
    text = shortened(value)
    return f"'{''.join(c if c.isprintable() else repr(c)[1:-1] for c in text)}'"


def shortened(value: object) -> str:
    """Return `value` as text that is not too long for a line."""
    text = str(value)
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."


def counted(count: int, noun: str) -> str:
    """Return a number of things for people: "1 message", "2 messages"."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def named(noun: str, names: Iterable[str]) -> str:
    """Return names with their noun for people: "task 'a'", "tasks 'a' and 'b'"."""
    shown = [f"'{name}'" for name in names]
    several = ", ".join(filter(None, [", ".join(shown[:-2]), " and ".join(shown[-2:])]))
    return f"{noun} {several}" if len(shown) == 1 else f"{noun}s {several}"


def format_cores(cores: float) -> str:
    """Return cores for people, as in ``1.5 cores``."""
    return f"{_number(cores)} {'core' if cores == 1 else 'cores'}"


def format_bytes(size: float) -> str:
    """Return a size [bytes] for people, as in ``512 MiB``."""
    return _scaled(size, {unit: _SIZES[unit] for unit in ("B", "KiB", "MiB", "GiB")})


def format_seconds(seconds: float) -> str:
    """Return a time [s] for people, as in ``200 ms``."""
    return _scaled(seconds, {"ns": 1e-9, "µs": 1e-6, "ms": 1e-3, "s": 1.0})


def format_bandwidth(bandwidth: float) -> str:
    """Return a bandwidth [bytes/s] for people, as in ``12.5 MB/s``."""
    return _scaled(bandwidth, {f"{u}/s": _SIZES[u] for u in ("B", "kB", "MB", "GB")})


def format_amount(resource: str, amount: float) -> str:
    """Return an amount of a resource, in its unit."""
    formats = {"cpu": format_cores, "memory": format_bytes}
    return formats.get(resource, _number)(amount)


def _similar(unit: str, dimension: Dimension) -> str:
    """Return a suggestion that means what was written, and all if it may mean two."""
    if found := _DATA.fullmatch(unit):
        return _data_units(found, dimension)
    word = unit.casefold()
    folded = {known.casefold(): known for known in dimension.units if known}
    alike = [known for known in folded if known[0] == word[0]]  # `MHz` is not `Hz`
    close = difflib.get_close_matches(word, alike, n=1, cutoff=_CLOSE)
    return f" (did you mean '{folded[close[0]]}'?)" if close else ""


def _data_units(found: re.Match[str], dimension: Dimension) -> str:
    """Suggest bits and bytes: people write both with either case of the letter."""
    prefix, binary, letter = found["prefix"].upper(), found["binary"], found["letter"]
    small = prefix if binary else prefix.replace("K", "k")
    per = "/s" if dimension is BANDWIDTH else ""
    bits = f"{prefix.replace('K', 'k')}bit{per}"
    bytes_ = f"{small}{binary.lower()}B{per}"
    choices = [bits, bytes_] if letter == "b" else [bytes_, bits]
    named = " or ".join(f"'{unit}'" for unit in choices if unit in dimension.units)
    return f" (did you mean {named}? 1 byte B is 8 bit)" if named else ""


def _scaled(value: float, units: Mapping[str, float]) -> str:
    """Write `value` in the largest unit in which it is at least 1."""
    fits = [unit for unit, factor in units.items() if abs(value) >= factor * 0.9995]
    smallest = "s" if "s" in units else next(iter(units))
    unit = fits[-1] if fits else (smallest if value == 0 else next(iter(units)))
    return f"{_number(value / units[unit])} {unit}"


def _number(value: float) -> str:
    """Write three significant digits, without an exponent below a million."""
    if abs(value) >= 999.5:  # noqa: PLR2004, it rounds to four digits
        return f"{value:.0f}" if abs(value) < 1e6 else f"{value:.3g}"  # noqa: PLR2004
    return f"{value:.3g}"
