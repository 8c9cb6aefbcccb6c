"""Conditions: expressions over the values of one subject, as in `memory > 200 MiB`.

Python's parser reads them, and its compiler gets only what was checked. So a condition
can neither fail at run time nor do anything.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Mapping
from itertools import pairwise
from string import Formatter
from typing import Any, TypeAlias

from msgspec import Struct
from msgspec import inspect as types

from poise import units
from poise.errors import did_you_mean, listed
from poise.model.file_keys import keys_of
from poise.units import Dimension, quoted

LONGEST = 500
"""[characters] A longer condition is an error."""
Value: TypeAlias = Any
"""A truth value, a number or a text."""
Names: TypeAlias = Mapping[str, "_Kind"]

_WORDS = {"and", "or", "not"}
_TOKEN = re.compile(
    r"(?P<text>\"[^\"]*\"|'[^']*')"
    r"|(?<![\w.])(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
    r"(?:\s*(?P<unit>%|[A-Za-zµ\u03bc]\w*(?:/s)?))?"
)
_OF_UNIT = {
    unit: frozenset(d.name for d in units.DIMENSIONS.values() if unit in d.units)
    for d in units.DIMENSIONS.values()
    for unit in d.units
}


class _Kind(Struct, frozen=True):
    """What an expression yields."""

    type: str  # `truth value`, `number` or `text`
    # of a number: what it may measure; None: anything
    dimensions: frozenset[str] | None = None
    choices: tuple[str, ...] = ()  # of a text: what it may be; none: anything
    is_constant: bool = False  # whether it is a text that stands in the condition


_TRUTH, _NUMBER, _TEXT = _Kind("truth value"), _Kind("number"), _Kind("text")
_Read: TypeAlias = Callable[[Any], Value]
_Constant: TypeAlias = tuple[float, _Kind]


class Condition(Struct, frozen=True):
    """A condition that was checked; call it with a record of its subject's values."""

    text: str
    read: _Read

    def __call__(self, values: Struct) -> bool:
        """Return whether it holds."""
        return bool(self.read(values))


def parse_condition(
    text: str, record: type[Struct], choices: Mapping[str, tuple[str, ...]] = {}
) -> Condition:
    """Return the condition in a text."""
    if len(text) > LONGEST:
        raise ValueError(f"is longer than {LONGEST} characters")
    constants: dict[str, _Constant] = {}

    def place(match: re.Match[str]) -> str:
        if match["text"] is not None:
            return match[0]
        name = f"_{len(constants)}"
        constants[name] = _quantity(match)
        return f"{name} {match['unit']}" if match["unit"] in _WORDS else name

    python = _TOKEN.sub(place, text)
    try:
        tree = ast.parse(python.strip(), mode="eval").body
    except (SyntaxError, MemoryError, RecursionError, ValueError):
        raise ValueError(
            f"{quoted(text)} is not a condition; write, for instance, "
            "'used > 90% and starved >= 0.1'"
        ) from None
    checked = _Checker(_names(record, choices), constants).of("truth value", tree)
    return Condition(text, _compiled(checked))


def _compiled(checked: ast.expr) -> _Read:
    """Return what evaluates a checked expression of the values in a record."""
    whole = ast.parse(f"lambda {_RECORD}: 0", mode="eval")
    assert isinstance(whole.body, ast.Lambda)  # noqa: S101, as it is written
    whole.body.body = checked
    code = compile(ast.fix_missing_locations(whole), "<condition>", "eval")
    read: _Read = eval(code, dict(_FUNCTIONS))  # noqa: S307, it was checked
    return read


def check_sentence(text: str, record: type[Struct]) -> None:
    """Raise ValueError when a sentence names a value that a subject does not have."""
    names = keys_of(record)
    for _, name, form, conversion in Formatter().parse(text):
        if name is not None and (name not in names or form or conversion):
            raise ValueError(
                f"{{{name}}} is not a value{did_you_mean(name, names)}; "
                f"values: {listed(names)}"
            )


def sentence(text: str, values: Struct) -> str:
    """Return a checked sentence with the values of a subject."""
    kinds = _names(type(values), {})
    return text.format_map(
        {name: _shown(getattr(values, name), kind) for name, kind in kinds.items()}
    )


def _shown(value: Value, kind: _Kind) -> str:
    if value != value:  # noqa: PLR0124, it is not a number
        return "unknown"
    (dimension,) = kind.dimensions or ("",)
    return _FORMATS[dimension](value) if dimension in _FORMATS else str(value)


_FORMATS: Mapping[str, Callable[[float], str]] = {
    units.CORES.name: units.format_cores,
    units.BYTES.name: units.format_bytes,
    units.SECONDS.name: units.format_seconds,
    units.BANDWIDTH.name: units.format_bandwidth,
    units.RATIO.name: lambda share: f"{share:.0%}",
    units.RATE.name: lambda rate: f"{rate:.3g} Hz",
}


def _quantity(match: re.Match[str]) -> tuple[float, _Kind]:
    number, unit = float(match["number"]), match["unit"] or ""
    if not math.isfinite(number):
        raise ValueError(f"{quoted(match[0])} is too large for a number")
    if not unit or unit in _WORDS:
        return number, _NUMBER
    if unit not in _OF_UNIT:
        raise ValueError(
            f"{quoted(match[0])} has the unknown unit '{unit}'"
            f"{did_you_mean(unit, _OF_UNIT)}; units: "
            f"{', '.join(sorted(filter(None, _OF_UNIT)))}"
        )
    dimensions = _OF_UNIT[unit]
    factors = (d.units for d in units.DIMENSIONS.values() if unit in d.units)
    return number * next(factors)[unit], _Kind("number", dimensions)


def _names(record: type[Struct], choices: Mapping[str, tuple[str, ...]]) -> Names:
    kinds = {}
    for name, key in keys_of(record).items():
        kind: types.Type = key.kind
        dimension: Dimension | None = None
        while isinstance(kind, types.Metadata):
            dimension = dimension or (kind.extra or {}).get("dimension")
            kind = kind.type
        if isinstance(kind, types.BoolType):
            kinds[name] = _TRUTH
        elif isinstance(kind, types.LiteralType):
            kinds[name] = _Kind("text", choices=tuple(map(str, kind.values)))
        elif isinstance(kind, types.StrType):
            kinds[name] = _Kind("text", choices=choices.get(name, ()))
        else:
            of = dimension or units.NUMBER
            kinds[name] = _Kind("number", frozenset((of.name,)))
    return kinds


_RECORD = "record"


class _Checker:
    """Checks an expression, and returns it as one of the values in a record."""

    def __init__(self, names: Names, constants: Mapping[str, _Constant]) -> None:
        self._names = names
        self._constants = constants

    def expression(self, node: ast.expr) -> tuple[_Kind, ast.expr]:
        match node:
            case ast.Name(id):
                return self._name(id)
            case ast.Constant(str() as text):
                return _Kind("text", choices=(text,), is_constant=True), node
            case ast.BoolOp() | ast.UnaryOp(ast.Not()) | ast.Compare():
                return _TRUTH, self._logic(node)
            case ast.UnaryOp(ast.USub() as op, inner):
                kind, negated = self._of("number", inner)
                return kind, ast.UnaryOp(op, negated)
            case ast.BinOp(
                left, ast.Add() | ast.Sub() | ast.Mult() | ast.Div() as op, right
            ):
                return self._arithmetic(left, op, right)
        raise ValueError(
            "a condition has names of values, numbers with units, texts in quotes, "
            "and, or, not, comparisons and + - * / only"
        )

    def _logic(self, node: ast.BoolOp | ast.UnaryOp | ast.Compare) -> ast.expr:
        if isinstance(node, ast.Compare):
            return self._comparisons(node.left, node.ops, node.comparators)
        if isinstance(node, ast.UnaryOp):
            if (opposite := _opposite(node.operand)) is not None:
                return self.of("truth value", opposite)
            return ast.UnaryOp(node.op, self.of("truth value", node.operand))
        parts = [self.of("truth value", part) for part in node.values]
        return ast.BoolOp(node.op, parts)

    def _name(self, name: str) -> tuple[_Kind, ast.expr]:
        if name in self._constants:
            value, kind = self._constants[name]
            return kind, ast.Constant(value)
        if name not in self._names:
            raise ValueError(
                f"there is no value '{name}'{did_you_mean(name, self._names)}; "
                f"values: {listed(self._names)}"
            )
        record = ast.Name(_RECORD, ast.Load())
        return self._names[name], ast.Attribute(record, name, ast.Load())

    def of(self, wanted: str, node: ast.expr) -> ast.expr:
        """Return an expression of the wanted type; ValueError for others."""
        return self._of(wanted, node)[1]

    def _of(self, wanted: str, node: ast.expr) -> tuple[_Kind, ast.expr]:
        kind, checked = self.expression(node)
        if kind.type != wanted:
            what = quoted(node.id) if isinstance(node, ast.Name) else "a part of it"
            if what[1:-1] in self._constants:
                what = f"{self._constants[what[1:-1]][0]:g}"
            raise ValueError(f"{what} is a {kind.type}, not a {wanted}: compare it")
        return kind, checked

    def _arithmetic(
        self, left: ast.expr, op: ast.operator, right: ast.expr
    ) -> tuple[_Kind, ast.expr]:
        kind, first = self._of("number", left)
        other, second = self._of("number", right)
        kind = _common(kind, other) if isinstance(op, ast.Add | ast.Sub) else _NUMBER
        if isinstance(op, ast.Div):
            return kind, _call(_divide, first, second)
        return kind, ast.BinOp(first, op, second)

    def _comparisons(
        self, left: ast.expr, ops: list[ast.cmpop], rights: list[ast.expr]
    ) -> ast.expr:
        steps: list[ast.expr] = []
        for op, right in zip(ops, rights, strict=True):
            if type(op) not in _COMPARISONS:
                raise ValueError("compare with < <= > >= == or !=")
            (kind, first), (other, second) = map(self.expression, (left, right))
            _check_alike(kind, other, op)
            if isinstance(op, ast.NotEq):
                steps.append(_call(_differ, first, second))
            else:
                steps.append(ast.Compare(first, [op], [second]))
            left = right
        return steps[0] if len(steps) == 1 else ast.BoolOp(ast.And(), steps)


def _opposite(node: ast.expr) -> ast.expr | None:
    """Return what holds where an expression does not; None: it compares nothing.

    Neither holds of what is not known, so `not` may not stand before a comparison.
    """
    match node:
        case ast.UnaryOp(ast.Not(), inner):
            return inner
        case ast.BoolOp(op, parts):
            other = ast.Or() if isinstance(op, ast.And) else ast.And()
            return ast.BoolOp(other, [ast.UnaryOp(ast.Not(), part) for part in parts])
        case ast.Compare(left, [op], [right]) if type(op) in _COMPARISONS:
            return ast.Compare(left, [_COMPARISONS[type(op)]()], [right])
        case ast.Compare(left, [_, _, *_] as ops, rights):
            pairs = zip(ops, pairwise([left, *rights]), strict=True)
            steps = [ast.Compare(one, [op], [another]) for op, (one, another) in pairs]
            return _opposite(ast.BoolOp(ast.And(), [*steps]))
    return None


def _call(function: Callable[..., Value], *values: ast.expr) -> ast.expr:
    return ast.Call(ast.Name(function.__name__, ast.Load()), [*values], [])


def _check_alike(kind: _Kind, other: _Kind, op: ast.cmpop) -> None:
    """Raise ValueError when two expressions cannot be compared."""
    if kind.type != other.type:
        raise ValueError(f"a {kind.type} cannot be compared with a {other.type}")
    if kind.type == "number":
        _common(kind, other)
    elif not isinstance(op, ast.Eq | ast.NotEq):
        raise ValueError(f"a {kind.type} is compared with == or != only")
    elif kind.choices and other.choices and not {*kind.choices} & {*other.choices}:
        if not kind.is_constant:
            kind, other = other, kind
        text, known = kind.choices[0], other.choices
        raise ValueError(
            f"'{text}' is none of {listed(known)}{did_you_mean(text, known)}"
        )


def _common(kind: _Kind, other: _Kind) -> _Kind:
    """Return what two numbers may both measure; ValueError when there is nothing."""
    if kind.dimensions is None:
        return other
    if other.dimensions is None:
        return kind
    if not (both := kind.dimensions & other.dimensions):
        first, second = (" or ".join(sorted(k.dimensions or ())) for k in (kind, other))
        raise ValueError(f"a {first} cannot be compared with a {second}")
    return _Kind("number", both)


def _divide(dividend: float, divisor: float) -> float:
    """Divide; by 0, infinity or, 0 / 0, not a number: no comparison of it holds."""
    if divisor:
        return dividend / divisor
    return math.inf * dividend if dividend else math.nan


def _differ(one: Value, another: Value) -> bool:
    """Return whether two values are known and not the same.

    Python says that what is not a number differs from all; a policy would then act
    because nothing was measured.
    """
    return bool(one == one and another == another and one != another)  # noqa: PLR0124


_FUNCTIONS = {function.__name__: function for function in (_divide, _differ)}
_COMPARISONS: Mapping[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE,
    ast.GtE: ast.Lt,
    ast.Gt: ast.LtE,
    ast.LtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
}
"""Comparisons, and their opposites."""
