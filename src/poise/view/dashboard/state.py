"""What the page shows, as plain values: named parts of named records. Pure."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

from poise.session.running_robots.running import ChainReport, JournalEntry, Status
from poise.view.robot_view import ConnectorRow, Look, Reader, containers

Records = dict[str, dict[str, Any]]
Page = dict[str, Records]
"""Part -> name -> what is shown of it."""

MOST_SHOWN = 200
"""So many decisions are shown."""
_NEWS_EVERY = 1.0
"""A page is sent at least an empty update so often [s]."""


class PageState:
    """Makes the page's state of what a reader sees."""

    def __init__(self) -> None:
        self._reader = Reader()

    def of(self, look: Look, at: float) -> Page:
        """Return the state."""
        page: Page = {"robot": {"": _robot(look)}, "entries": _entries(look)}
        status = look.status
        if status is None:
            return page
        timers, view = dict(_timers(status)), self._reader.take(status, at)
        for row in view.timers:
            timers[row.name]["now"] = (
                _round(row.missed / row.rate) if row.rate else None
            )
        page["timers"] = timers
        page["chains"] = {each.name: _chain(each) for each in status.chains}
        page["connectors"] = {each.name: _connector(each) for each in view.connectors}
        page["components"] = components = dict(_components(status))
        for each in timers.values():
            component = components.get(each["component"])  # None: it is being ended
            if component and each["deadline"] is not None and each.get("now"):
                component["late"] = max(component.get("late", 0.0), each["now"])
        page["computers"] = dict(_computers(status, components))
        return page


def changes(before: Page, after: Page) -> dict[str, Any]:
    """Return what of a page has changed: for each part its new records, None: gone."""
    found: dict[str, Any] = {}
    for part in before.keys() | after.keys():
        old, new = before.get(part, {}), after.get(part, {})
        differ: dict[str, Any] = {n: r for n, r in new.items() if old.get(n) != r}
        differ |= dict.fromkeys(old.keys() - new.keys())
        if differ:
            found[part] = differ
    return found


class Updates:
    """What one page is sent: what has changed since it took the last update."""

    def __init__(self) -> None:
        self.is_whole = True
        """Whether the last update was all there is."""
        self._sent: Page = {}
        self._sent_at = 0.0
        self._is_on_the_way = False

    def begin_anew(self) -> None:
        """Send everything next: the connection is another one."""
        self._sent, self._is_on_the_way = {}, False

    def note_taken(self) -> None:
        """Let the next one be sent; so on a slow link nothing queues."""
        self._is_on_the_way = False

    def next(self, page: Page, now: float) -> dict[str, Any] | None:
        """Return an update at a time [s]; None: not now, or nothing was read since.

        It may be empty: a page that hears nothing at all says so.
        """
        if self._is_on_the_way or page is self._sent:
            return None
        differ = changes(self._sent, page)
        if not differ and now - self._sent_at < _NEWS_EVERY:
            return None
        self.is_whole = not self._sent
        self._sent, self._sent_at, self._is_on_the_way = page, now, True
        return differ


def _robot(look: Look) -> dict[str, Any]:
    status = look.status
    shown: dict[str, Any] = {"trouble": look.trouble, "since": look.since}
    if status is not None:
        shown |= {
            "name": status.robot,
            "task": status.task,
            "tasks": [_task(each) for each in status.tasks],
            "deviations": [each.what for each in status.deviations],
        }
    return shown


def _task(report: Any) -> str:  # noqa: ANN401, `view` does not import the manager
    """Return how a task is, what it does now, and what comes next."""
    why = f" ({report.why})" if report.why else ""
    now = [each.name for each in report.actions if each.is_at_work]
    then = [each.name for each in report.actions if not each.is_at_work]
    parts = [f"{report.name}: {report.state}{why}"]
    parts += [f"now {', '.join(now)}"] if now else []
    parts += [f"waits to begin {', '.join(then)}"] if then else []
    parts += [f"next {', '.join(report.next)}"] if report.next else []
    return "; ".join(parts)


def _entries(look: Look) -> Records:
    return {
        str(each.number): {
            "number": each.number,
            "at": round(each.at, 2),
            "kind": each.kind,
            "what": each.what,
            "why": why(each),
        }
        for each in look.entries[-MOST_SHOWN:]
    }


def why(entry: JournalEntry) -> str:
    """Return why something was decided, in words; empty: the sentence says all."""
    facts: Mapping[str, Any] = entry.facts if isinstance(entry.facts, dict) else {}
    parts = [
        f"policy '{each['policy']}' saw: {_values(each['saw'])}"
        for each in facts.get("policies", ())
    ]
    decision = facts.get("decision") or {}
    if proposal := proposal_in(facts):
        now, then = proposal["now"]["total"], proposal["then"]["total"]
        parts.append(f"F = {now:.4g} becomes {then:.4g}")
    if decision.get("gain") or decision.get("cost"):
        parts.append(
            f"gain {decision['gain']:.2f}, cost {decision['cost']:.2f} core-seconds"
        )
    return "; ".join(parts)


def proposal_in(facts: Mapping[str, Any]) -> Any:  # noqa: ANN401, JSON's
    """Return the proposal or what-if among an entry's facts; None: there is none."""
    decision = facts.get("decision") or {}
    return decision.get("proposal") or facts.get("proposal") or facts.get("what_if")


def _values(saw: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}"
        for name, value in saw.items()
        if isinstance(value, int | float | str)
    )


def _timers(status: Status) -> Iterator[tuple[str, dict[str, Any]]]:
    for _, container in containers(status):
        for component in container.components:
            for timer in component.timers:
                yield (
                    f"{component.name}.{timer.name}",
                    {
                        "component": component.name,
                        "period": timer.period,
                        "deadline": timer.deadline,
                        "releases": timer.releases,
                        "missed": timer.missed,
                        "p99": _round(timer.duration.p99),
                    },
                )


def _chain(chain: ChainReport) -> dict[str, Any]:
    return {
        "deadline": chain.deadline,
        "missed": chain.missed,
        "uses": chain.age.count,
        "median": _round(chain.age.median),
        "p99": _round(chain.age.p99),
        "hops": [[hop.component, _round(hop.age.median)] for hop in chain.hops],
    }


def _connector(row: ConnectorRow) -> dict[str, Any]:
    source, target = _ends(row.name)
    return {
        "source": source,
        "target": target,
        "kind": row.kind,
        "ready": row.is_joined,
        "rate": _round(row.rate),
        "bytes": _round(row.traffic),
        "drops": row.drops,
        "errors": row.errors,
    }


def _ends(connector: str) -> tuple[str, str]:
    """Return the components that a connector joins, by its name."""
    found = re.fullmatch(r"(.+?)\.\w+-(.+)\.\w+", connector)
    return (found[1], found[2]) if found else ("", "")


def _components(status: Status) -> Iterator[tuple[str, dict[str, Any]]]:
    needs = {each.component: each.estimate for each in status.demand_estimates}
    shown: Records = {
        name: {"at": computer, "state": "not there", "in": ""}
        for name, computer in status.placement.items()
    }
    for key, container in containers(status):
        for component in container.components:
            each = shown.get(component.name)
            if each and (each["at"] == key.computer or each["state"] == "not there"):
                each |= {
                    "state": component.state,
                    "in": container.name,
                    "errors": component.errors,
                    "error": component.error.rstrip().rpartition("\n")[2],
                    "hung": round(component.hung, 1),
                }
    for name, each in shown.items():
        if (need := needs.get(name)) is not None:
            each["cpu"], each["starved"] = _round(need.mean), _round(need.starved)
            each["sure"] = None if need.error is None else _round(need.error)
        if each["at"] in status.not_known():
            each["state"] = "unknown"
        yield name, each


def _computers(
    status: Status, components: Records
) -> Iterator[tuple[str, dict[str, Any]]]:
    unknown = status.not_known()
    for name in sorted({*status.computers, *status.placement.values(), *unknown}):
        agent, load = status.computers.get(name), status.loads.get(name)
        here = [each for each in components.values() if each["at"] == name]
        sure = [each.get("sure") or 0.0 for each in here]
        each: dict[str, Any] = {
            "state": "out of reach" if name in unknown else "",
            "need": _round(sum(each.get("cpu", 0.0) for each in here)),
            "sure": _round(math.hypot(*sure)),
            "memory": agent.memory if agent else 0,
        }
        if load is not None:
            each |= {
                "capacity": load.capacity,
                "used": _round(load.used),
                "background": _round(load.background),
            }
        yield name, each


def _round(value: float) -> float:
    """Return three digits: what cannot be seen is not sent again."""
    return float(f"{value:.3g}")
