"""Conditions: what they say, and what is wrong with them."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from poise.model.condition import check_sentence, parse_condition, sentence
from poise.model.policy import ChainValues, ComponentValues, ComputerValues, LinkValues

FRESH = ChainValues(name="x", component="c", computer="left")
FULL = ComputerValues(
    name="left", capacity=0.5, used=0.49, full=True, memory=300 * 2**20, late=2
)


@pytest.mark.parametrize(
    ("text", "holds"),
    [
        ("full", True),
        ("not full", False),
        ("not not full", True),
        ("not (full and late > 2)", True),
        ("not (lost or late == 3)", True),
        ("not 10% < used < 40%", True),
        ("not 10% < used < 50%", False),
        ("not name == 'left'", False),
        ("full and late > 2", False),
        ("late" + " + 1" * 100 + " == 102", True),
        ("full and (late > 2 or memory > 200 MiB)", True),
        ("memory > 0.2 GiB and memory < 1GB", True),
        ("used >= 98% * capacity", True),
        ("used / capacity > 99%", False),
        ("10% < used <= 49%", True),
        ("used - 0.4 < 10%", True),
        ("-used < 0", True),
        ("name == 'left'", True),
        ("name != 'left' or lost", False),
        ("late>1and full", True),
    ],
)
def test_a_condition_means_what_it_says(text: str, *, holds: bool) -> None:
    assert parse_condition(text, ComputerValues)(FULL) is holds


def test_a_micro_sign_may_be_a_greek_letter() -> None:
    assert parse_condition("age < 5 \u03bcs", ChainValues)(FRESH)


def test_nothing_is_more_than_what_is_divided_by_nothing() -> None:
    share = parse_condition("used / capacity > 90%", ComputerValues)
    assert not share(ComputerValues(name="x"))  # 0 / 0
    assert share(ComputerValues(name="x", used=1.0))


@pytest.mark.parametrize("comparison", ["<", "<=", ">", ">=", "==", "!="])
def test_no_comparison_holds_for_nothing_divided_by_nothing(comparison: str) -> None:
    nothing = ComputerValues(name="x")
    for text in (
        f"used / capacity {comparison} 90%",
        f"90% {comparison} used / capacity",
        f"not used / capacity {comparison} 90%",
        f"not (not full and not used / capacity {comparison} 90%)",
    ):
        assert not parse_condition(text, ComputerValues)(nothing)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("memry > 1", "there is no value 'memry' (did you mean 'memory'?)"),
        ("memory > 200 ms", "a size cannot be compared with a time"),
        ("memory > 20%", "a size cannot be compared with a number of cores or share"),
        ("memory + used > 1", "a size cannot be compared with a number of cores"),
        ("used > 5 GHz", "has the unknown unit 'GHz'"),
        ("used", "'used' is a number, not a truth value: compare it"),
        ("full and 3", "3 is a number, not a truth value: compare it"),
        ("full > 3", "a truth value cannot be compared with a number"),
        ("name > 'a'", "a text is compared with == or != only"),
        ("used in (1, 2)", "compare with < <= > >= == or !="),
        ("used >", "'used >' is not a condition"),
        ("", "'' is not a condition"),
        ("(" * 300, "is not a condition"),
        ("1" * 501, "is longer than 500 characters"),
        ("used > 1e999", "is too large for a number"),
        ("__import__('os').system('true')", "a condition has names of values"),
        ("used ** 9 ** 9 > 1", "a condition has names of values"),
        ("name.__class__ == 'x'", "a condition has names of values"),
        ("[c for c in name]", "a condition has names of values"),
    ],
)
def test_a_wrong_condition_says_what_is_wrong(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        parse_condition(text, ComputerValues)


def test_a_name_that_the_robot_does_not_have_is_wrong() -> None:
    with pytest.raises(ValueError, match="'rihgt' is none of 'left', 'right'") as error:
        parse_condition("name == 'rihgt'", ComputerValues, {"name": ("left", "right")})
    assert "did you mean 'right'?" in str(error.value)


def test_a_state_that_there_is_not_is_wrong() -> None:
    with pytest.raises(ValueError, match="did you mean 'failed'"):
        parse_condition("'faild' == state", ComponentValues)


@given(st.text(alphabet="used()<>=+-*/% 0.19Mib'\"andort_", max_size=40))
def test_any_text_is_a_condition_or_a_value_error(text: str) -> None:
    try:
        condition = parse_condition(text, ComputerValues)
    except ValueError:
        return
    assert condition(FULL) in {True, False}


def test_a_sentence_shows_values_with_their_units() -> None:
    text = "'{name}' uses {used} and {memory}, {late} are late"
    check_sentence(text, ComputerValues)
    assert sentence(text, FULL) == ("'left' uses 0.49 cores and 300 MiB, 2 are late")
    link = LinkValues(name="a-b", bandwidth=12.5e6, traffic=math.inf, trip=0.002)
    assert sentence("{bandwidth} {trip}", link) == "12.5 MB/s 2 ms"


@pytest.mark.parametrize("text", ["{nam}", "{}", "{used:.2f}", "{name!r}", "{used"])
def test_a_sentence_with_anything_else_is_wrong(text: str) -> None:
    with pytest.raises(ValueError, match=r"value|expected"):
        check_sentence(text, ComputerValues)
