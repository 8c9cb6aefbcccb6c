"""Reads Protocol Buffers by the description that is beside them, with their library."""

from __future__ import annotations

from typing import Any

import pytest


def decoded(description: bytes, name: str, data: bytes) -> dict[str, Any]:
    """Return a message as plain data; numbers and texts that lack are as by default."""
    pb2 = pytest.importorskip("google.protobuf.descriptor_pb2")
    pools = pytest.importorskip("google.protobuf.descriptor_pool")
    factory = pytest.importorskip("google.protobuf.message_factory")
    pool = pools.DescriptorPool()
    for file in pb2.FileDescriptorSet.FromString(description).file:
        pool.Add(file)
    class_ = factory.GetMessageClass(pool.FindMessageTypeByName(name))
    return plain(class_.FromString(data))


def plain(message: Any) -> dict[str, Any]:
    """Return a message as plain data."""
    names = [field.name for field in message.DESCRIPTOR.fields]
    return {name: _plain(getattr(message, name)) for name in names}


def _plain(value: Any) -> Any:
    if hasattr(value, "DESCRIPTOR"):
        return plain(value)
    if isinstance(value, int | float | str | bytes):
        return value
    return [_plain(each) for each in value]
