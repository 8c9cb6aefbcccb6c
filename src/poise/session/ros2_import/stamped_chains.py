"""Finds along which nodes stamps are passed on, from what their messages had; pure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from msgspec import Struct

from poise.session.ros2_import.graph_records import Age, Flow, Topic

_SHARE, _FEWEST = 0.8, 5
"""So many stamps of an output are those of an input, if it passes them on."""


class StampedChain(Struct, frozen=True, kw_only=True):
    """Nodes along which a stamp is passed on, and its age on the last topic."""

    topic: str
    nodes: tuple[str, ...]
    age: Age | None


def chains_of(topics: Sequence[Topic]) -> Iterator[StampedChain]:
    """Yield the longest chains, each with a subscriber of its last topic at its end."""
    for topic in topics:
        for flow in topic.flows:
            if _next_of(flow, topic, topics):
                continue
            nodes = _back_from(flow, topics, ())
            for last in topic.subscribers:
                if len(nodes) > 1 and last not in nodes:
                    yield StampedChain(
                        topic=topic.name, nodes=(*nodes, last), age=flow.age
                    )


def _back_from(
    flow: Flow, topics: Sequence[Topic], after: tuple[str, ...]
) -> tuple[str, ...]:
    """Return the nodes that a stamp went through until it was in `flow`."""
    nodes = (flow.node, *after)
    for topic in topics:
        if flow.node not in topic.subscribers:
            continue
        for source in topic.flows:
            if source.node not in nodes and _passes_on(source, flow):
                return _back_from(source, topics, nodes)
    return nodes


def _next_of(flow: Flow, topic: Topic, topics: Sequence[Topic]) -> bool:
    """Whether a subscriber passes the stamps on."""
    return any(
        after.node in topic.subscribers and _passes_on(flow, after)
        for other in topics
        if other.name != topic.name
        for after in other.flows
    )


def _passes_on(source: Flow, result: Flow) -> bool:
    """Whether nearly all stamps of `result` are stamps of `source`, and older then."""
    known = set(source.stamps)
    if not (known and source.age and result.age):
        return False
    comparable = [each for each in result.stamps if min(known) <= each <= max(known)]
    equal = sum(stamp in known for stamp in comparable)
    is_same = len(comparable) >= _FEWEST and equal >= _SHARE * len(comparable)
    return is_same and source.age.median < result.age.median
