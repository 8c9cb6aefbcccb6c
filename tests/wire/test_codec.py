from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from poise.runtime.component.ports import Message
from poise.wire.codec import WireError, codec, pack, unpack


class Ranges(Message, frozen=True):
    stamp: float
    ranges: NDArray[np.float32]


def over_the_wire(value: object, type_: Any) -> Any:
    own: Any = type(value)
    body, buffers = codec(own).encode(value)
    return codec(type_).decode(body, memoryview(b"".join(buffers)))


def test_arrays_inside_messages_come_over() -> None:
    sent = Ranges(1.5, np.arange(4, dtype=np.float32))
    received = over_the_wire(sent, Ranges)
    assert received.stamp == 1.5
    np.testing.assert_array_equal(received.ranges, sent.ranges)
    assert not received.ranges.flags.writeable


@pytest.mark.parametrize("type_", [NDArray[np.float32], NDArray[Any], np.ndarray])
def test_arrays_alone_come_over(type_: Any) -> None:
    sent = np.ones((2, 3), np.float32)
    np.testing.assert_array_equal(over_the_wire(sent, type_), sent)


def test_refuses_an_array_of_another_type() -> None:
    with pytest.raises(WireError, match="array of float32, not int8"):
        over_the_wire(np.ones(3, np.float32), NDArray[np.int8])


class Positive(Message):
    kelvin: float

    def __post_init__(self) -> None:
        assert self.kelvin >= 0, "below absolute zero"


def test_refuses_what_a_message_asserts_not_to_be() -> None:
    body, why = msgspec.msgpack.encode({"kelvin": -1.0}), "AssertionError: below absol"
    with pytest.raises(WireError, match=f"not Positive: {why}"):
        codec(Positive).decode(body, memoryview(b""))
    with pytest.raises(WireError, match=why):
        unpack(pack({"kelvin": -1.0}), Positive)


class Anything(Message):
    what: Any


class Thing(Message):
    what: object


@pytest.mark.parametrize("sent", [None, 7, [0.5, "half"], {"a": True}])
def test_what_is_declared_as_any_object_comes_over(sent: Any) -> None:
    assert over_the_wire(Thing(sent), Thing).what == sent
    assert unpack(pack(Thing(sent)), Thing).what == sent
    assert over_the_wire([sent], list[object]) == [sent]


class Plain(Message):
    count: int
    share: float


ARRAYS = [
    np.array(3.5),
    np.zeros((0, 3)),
    np.zeros(3, np.float16),
    np.arange(16).reshape(4, 4)[::2, ::-2],
    np.arange(3, dtype=">i4"),
    np.array([True, False]),
    np.array([1 + 2j]),
    np.array(["zwei", "drei"]),
    np.array([b"x"]),
    np.array(["2020-01-01"], "M8[s]"),
]


@pytest.mark.parametrize("sent", ARRAYS, ids=lambda a: a.dtype.str)
def test_arrays_of_every_kind_come_over_as_they_were(sent: NDArray[Any]) -> None:
    received = over_the_wire(Anything(sent), Anything).what
    assert (received.dtype, received.shape) == (sent.dtype, sent.shape)
    np.testing.assert_array_equal(received, sent)


def test_an_array_with_a_declared_shape_comes_over() -> None:
    type_ = np.ndarray[tuple[int, int], np.dtype[np.float32]]
    sent = np.ones((2, 3), np.float32)
    np.testing.assert_array_equal(over_the_wire(sent, type_), sent)


def test_the_memory_of_an_array_is_not_copied_on_the_way_out() -> None:
    sent = np.arange(6.0)
    _, (buffer,) = codec(np.ndarray).encode(sent)
    assert np.shares_memory(np.asarray(buffer), sent)


def test_numbers_of_numpy_come_over_as_numbers() -> None:
    sent: Any = Plain(np.int64(3), np.float32(0.5))  # type: ignore[arg-type]
    assert over_the_wire(sent, Plain) == Plain(3, 0.5)


@pytest.mark.parametrize(
    ("value", "says"),
    [
        (object(), "a value of type object cannot cross a connector"),
        (print, "type builtin_function_or_method cannot cross"),
        (np.array([None]), "an array of object cannot cross"),
        (np.zeros(2, [("x", "f4")]), "one for each field"),
        (np.zeros(2, np.longdouble), "but not of longdouble"),
        (np.zeros(2, np.clongdouble), "but not of longdouble"),
        (np.ma.array([1, 2], mask=[False, True]), "its mask would be lost"),
        (1 << 70, "Anything cannot cross a connector: can't serialize ints"),
        ("\ud800", "surrogates not allowed"),
    ],
)
def test_what_no_wire_carries_is_refused_where_it_is_sent(
    value: object, says: str
) -> None:
    with pytest.raises(WireError, match=says):
        codec(Anything).encode(Anything(value))


class Waypoint:
    pass


class Route(Message):
    stops: list[Waypoint]


@pytest.mark.parametrize("type_", [Waypoint, Route, tuple[Route, int]])
def test_a_type_that_no_wire_carries_is_refused_before_anything_is_sent(
    type_: Any,
) -> None:
    with pytest.raises(WireError, match="type Waypoint cannot cross a connector"):
        codec(type_)


def test_a_value_without_bottom_is_refused() -> None:
    endless: list[Any] = []
    endless.append(endless)
    with pytest.raises(WireError, match="Anything cannot cross"):
        codec(Anything).encode(Anything(endless))


def test_a_list_is_not_an_array() -> None:
    body = msgspec.msgpack.encode({"stamp": 1.0, "ranges": [1.0]})
    with pytest.raises(WireError, match="not Ranges: a list, not an array"):
        codec(Ranges).decode(body, memoryview(b""))


@pytest.mark.parametrize(
    ("values", "held"),
    [
        ([1.5], np.uint8),
        ([2], np.bool_),
        (["7"], np.int64),
        ([True, 0.5], np.int32),
        ([400], np.uint8),
    ],
)
def test_plain_data_becomes_no_other_numbers(values: list[Any], held: type) -> None:
    with pytest.raises(WireError, match=r"are no array of|out of bounds"):
        unpack(pack(values), np.ndarray[Any, np.dtype[held]])  # type: ignore[valid-type]


@pytest.mark.parametrize(
    ("values", "held"),
    [([1, 2], np.uint8), ([1, 2.5], np.float32), ([], np.uint8), (3, np.float64)],
)
def test_plain_data_that_fits_becomes_an_array(values: Any, held: type) -> None:
    array = unpack(pack(values), np.ndarray[Any, np.dtype[held]])  # type: ignore[valid-type]
    assert array.dtype == held
    np.testing.assert_array_equal(array, np.asarray(values))


def test_plain_data_fits_any_array_of_floating_numbers() -> None:
    array = unpack(pack([1.5]), np.ndarray[Any, np.dtype[np.floating[Any]]])
    assert array.tolist() == [1.5]


def test_keys_are_texts_in_json() -> None:
    assert unpack(pack({"7": "seven"}), dict[int, str]) == {7: "seven"}
    assert unpack(pack({7: "seven"}), dict[int, str]) == {7: "seven"}


def decoded_array(dtype: str, shape: tuple[int, ...], offset: int) -> Any:
    header = msgspec.msgpack.encode((dtype, shape, offset))
    body = msgspec.msgpack.encode({"what": msgspec.msgpack.Ext(1, header)})
    return codec(Anything).decode(body, memoryview(bytes(64))).what


@pytest.mark.parametrize(
    ("dtype", "shape", "offset"),
    [
        ("<f8", (9,), 0),  # 72 bytes of the 64 that came
        ("<f8", (1,), 57),
        ("<f8", (1,), 1 << 63),
        ("<f8", (1 << 40, 1 << 40), 0),
        ("<f8", (0, 1 << 63), 0),
        ("<f8", (-1,), 0),
        ("<f8", (1,), -8),
        ("<f8", (1,) * 70, 0),
        ("|O", (1,), 0),
        ("|V8", (1,), 0),
        ("f4,f4", (1,), 0),
        ("(2,3)f4", (1,), 0),
        ("<f7", (1,), 0),
        (",", (1,), 0),
        ("|S0", (1,), 0),
    ],
)
def test_an_array_that_lies_about_itself_is_refused(
    dtype: str, shape: tuple[int, ...], offset: int
) -> None:
    with pytest.raises(WireError, match="not Anything"):
        decoded_array(dtype, shape, offset)


def test_an_array_that_does_not_lie_is_taken() -> None:
    np.testing.assert_array_equal(decoded_array("<f8", (2, 2), 32), np.zeros((2, 2)))


@pytest.mark.parametrize(("code", "length"), [(9, 0), (1, 5_000)])
def test_an_unknown_extension_is_refused(code: int, length: int) -> None:
    body = msgspec.msgpack.encode({"what": msgspec.msgpack.Ext(code, bytes(length))})
    with pytest.raises(WireError, match=f"refused extension {code} of {length} B"):
        codec(Anything).decode(body, memoryview(b""))


def test_a_body_too_deep_is_refused() -> None:
    with pytest.raises(WireError, match=r"recursion|Stack overflow"):
        codec(list[Any]).decode(b"\x91" * 200_000, memoryview(b""))


HEADERS = st.tuples(
    st.text(max_size=6) | st.sampled_from(["<f8", "|O", "<U1", "<M8[s]", "|V4"]),
    st.lists(st.integers(-(2**63), 2**64 - 1) | st.integers(0, 3), max_size=3),
    st.integers(-(2**63), 2**64 - 1) | st.integers(0, 70),
)


@given(header=HEADERS | st.binary(max_size=30))
def test_any_header_of_an_array_is_an_array_or_refused(header: Any) -> None:
    data = header if isinstance(header, bytes) else msgspec.msgpack.encode(header)
    body = msgspec.msgpack.encode({"what": msgspec.msgpack.Ext(1, data)})
    try:
        array = codec(Anything).decode(body, memoryview(bytes(64))).what
    except WireError:
        return
    assert isinstance(array, np.ndarray)
    assert not array.flags.writeable


@given(
    body=st.binary(max_size=60),
    type_=st.sampled_from([Ranges, Plain, Anything, str, tuple[int, str], np.ndarray]),
)
def test_any_bytes_are_a_value_or_refused(body: bytes, type_: Any) -> None:
    try:
        value = codec(type_).decode(body, memoryview(bytes(16)))
    except WireError:
        return
    assert codec(type_).encode(value)
