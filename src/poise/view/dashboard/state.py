"""What the page shows, as plain values: named parts of named records. Pure."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from poise.errors import last_error
from poise.session.running_robots.running import ChainReport, JournalEntry, Status
from poise.view.robot_view import (
    ConnectorRow,
    LiveReading,
    Reader,
    TimerRow,
    containers,
)
from poise.wire.records.status_records import Summary

Records = dict[str, dict[str, Any]]
Page = dict[str, Records]
"""Part -> name -> what is shown of it."""

MOST_SHOWN = 200
"""How many decisions are shown."""
_NEWS_EVERY = 1.0
"""A page is sent at least an empty update so often [s]."""


class PageState:
    """Makes the page's state of what a reader sees."""

    def __init__(self) -> None:
        self._reader = Reader()
        self._history = RecentHistory()

    def of(self, seen: LiveReading, at: float) -> Page:
        """Return the state."""
        page: Page = {"robot": {"": _robot(seen)}, "entries": _entries(seen)}
        status = seen.status
        if status is None:
            return page
        view = self._reader.update(status, at)
        page["timers"] = timers = dict(_timers(status, view.timers))
        page["chains"] = {
            chain.name: _chain(chain, row.late, status)
            for chain, row in zip(status.chains, view.chains, strict=True)
        }
        page["connectors"] = {
            connector.name: _connector(connector) for connector in view.connectors
        }
        page["components"] = components = dict(_components(status))
        for timer in timers.values():
            component = components.get(timer["component"])  # None: it is being ended
            if component and timer["deadline"] is not None and timer["now"]:
                component["late"] = max(component.get("late", 0.0), timer["now"])
        page["computers"] = dict(_computers(status, components))
        self._history.note(page, seen)
        page["history"] = self._history.moments()
        return page


def changes(before: Page, after: Page) -> dict[str, Any]:
    """Return what of a page has changed: for each part its new records, None: gone."""
    changes: dict[str, Any] = {}
    for part in before.keys() | after.keys():
        old, new = before.get(part, {}), after.get(part, {})
        differ: dict[str, Any] = {n: r for n, r in new.items() if old.get(n) != r}
        differ |= dict.fromkeys(old.keys() - new.keys())
        if differ:
            changes[part] = differ
    return changes


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
        """Return an update at a time [s]; None: not now, or nothing was read since."""
        if self._is_on_the_way or page is self._sent:
            return None
        differ = changes(self._sent, page)
        if not differ and now - self._sent_at < _NEWS_EVERY:
            return None
        self.is_whole = not self._sent
        self._sent, self._sent_at, self._is_on_the_way = page, now, True
        return differ


def _robot(seen: LiveReading) -> dict[str, Any]:
    status = seen.status
    shown: dict[str, Any] = {
        "trouble": seen.trouble,
        "since": seen.since,
        "old": seen.is_old,
    }
    if status is not None:
        shown |= {
            "name": status.robot,
            "task": status.task,
            "tasks": [_task(report) for report in status.tasks],
            "startable": list(status.robot_tasks),
            "deviations": [
                each.what  # of agents, the first says why no manager answers
                for each in status.deviations[1 if status.by_agents else 0 :]
            ],
            "managed": not status.by_agents,
        }
    return shown


def _task(report: Any) -> dict[str, Any]:  # noqa: ANN401, `view` does not import the manager
    """Return how a task is, what it does now, and what comes next."""
    return {
        "name": report.name,
        "state": report.state,
        "why": report.why,
        "since": round(report.since, 1),
        "now": [action.name for action in report.actions if action.is_at_work],
        "waits": [action.name for action in report.actions if not action.is_at_work],
        "next": list(report.next),
    }


def _entries(seen: LiveReading) -> Records:
    return {
        str(entry.number): {
            "number": entry.number,
            "at": round(entry.at, 2),
            "kind": entry.kind,
            "what": entry.what,
            "why": why(entry),
        }
        for entry in seen.entries[-MOST_SHOWN:]
    }


def why(entry: JournalEntry) -> str:
    """Return why something was decided, in sentences; empty: the entry says all."""
    facts: Mapping[str, Any] = entry.facts if isinstance(entry.facts, dict) else {}
    said = [
        f"Policy '{policy['policy']}' saw of "
        f"'{policy['saw'].get('name', 'the robot')}': {_values(policy['saw'])}."
        for policy in facts.get("policies", ())
    ]
    if (proposal := proposal_in(facts)) and proposal.get("trouble"):
        said.append(f"As it was, {proposal['trouble']}.")
    decision = facts.get("decision") or {}
    if decision.get("gain") or decision.get("cost"):
        gain, cost = (f"{decision[name]:.2f}" for name in ("gain", "cost"))
        said.append(
            f"The change costs {cost} core-seconds of work and gains {gain}: "
            f"{'it was done' if decision.get('acts') else 'it was not done'}."
        )
    return " ".join(said)


def proposal_in(facts: Mapping[str, Any]) -> Any:  # noqa: ANN401, JSON's
    """Return the proposal or what-if among an entry's facts; None: there is none."""
    decision = facts.get("decision") or {}
    return decision.get("proposal") or facts.get("proposal") or facts.get("what_if")


def _values(saw: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{name.replace('_', ' ')} "
        f"{f'{value:.3g}' if isinstance(value, float) else value}"
        for name, value in saw.items()
        if name != "name" and value and isinstance(value, int | float | str)
    )


def _timers(
    status: Status, rows: Iterable[TimerRow]
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield timers; `now` is the share that is late; None: it is not known."""
    late = {row.name: row.missed / row.rate for row in rows if row.missed and row.rate}
    known = {row.name for row in rows if row.missed is not None}
    for _, component in status.located():
        for timer in component.timers:
            name = f"{component.name}.{timer.name}"
            shown = {
                "component": component.name,
                "period": timer.period,
                "deadline": timer.deadline,
                "releases": timer.releases,
                "missed": timer.missed,
                "p99": _measured(timer.duration, timer.duration.p99),
                "now": _round(late.get(name, 0.0)) if name in known else None,
                "known": name in known,
            }
            yield name, shown


def _chain(chain: ChainReport, late: float | None, status: Status) -> dict[str, Any]:
    """Return a chain; `now` is the share that is late; None: none was used lately."""
    at = {status.placement.get(hop.component) for hop in chain.hops}
    return {
        "deadline": chain.deadline,
        "missed": chain.missed,
        "uses": chain.age.count,
        "mean": chain.age.mean,
        "median": _measured(chain.age, chain.age.median),
        "p99": _measured(chain.age, chain.age.p99),
        "now": None if late is None else _round(late),
        "hops": [
            [hop.component, _measured(hop.age, hop.age.median)] for hop in chain.hops
        ],
        "known": not at & status.not_known(),
    }


def _connector(row: ConnectorRow) -> dict[str, Any]:
    source, target = _ends(row.name)
    return {
        "source": source,
        "target": target,
        "kind": row.kind or "unknown",
        "ready": row.is_joined,
        "rate": None if row.rate is None else _round(row.rate),
        "bytes": None if row.traffic is None else _round(row.traffic),
        "drops": row.drops,
        "errors": row.errors,
    }


def _ends(connector: str) -> tuple[str, str]:
    """Return the components that a connector joins, by its name."""
    match = re.fullmatch(r"(.+?)\.\w+-(.+)\.\w+", connector)
    return (match[1], match[2]) if match else ("", "")


def _components(status: Status) -> Iterator[tuple[str, dict[str, Any]]]:
    needs = {demand.component: demand.estimate for demand in status.demand_estimates}
    shown: Records = {
        name: {"at": computer, "state": "not there", "in": ""}
        for name, computer in status.placement.items()
    }
    for key, container in containers(status):
        for component in container.components:
            known = shown.get(component.name)
            if known and (known["at"] == key.computer or known["state"] == "not there"):
                hangs = component.name in status.hanging
                known |= {
                    "state": component.state,
                    "in": container.name,
                    "errors": component.errors,
                    "error": last_error(component.error),
                    "hung": round(component.hung, 1) if hangs else 0,
                }
    for name, shown_as in shown.items():
        if (need := needs.get(name)) is not None:
            shown_as |= {"cpu": _round(need.mean), "starved": _round(need.starved)}
            error = None if need.is_least else need.error
            shown_as["sure"] = None if error is None else _round(error)
        if shown_as["at"] in status.not_known():
            shown_as["state"] = "unknown"
        yield name, shown_as


def _computers(
    status: Status, components: Records
) -> Iterator[tuple[str, dict[str, Any]]]:
    unknown = status.not_known()
    for name in sorted({*status.computers, *status.placement.values(), *unknown}):
        agent, load = status.computers.get(name), status.loads.get(name)
        age = status.ages.get(name)
        here = [each for each in components.values() if each["at"] == name]
        needs = [component["cpu"] for component in here if "cpu" in component]
        sure = [component.get("sure") or 0.0 for component in here]
        row: dict[str, Any] = {
            "state": "not known" if name in unknown else "",
            "age": round(age) if age is not None and name in unknown else None,
            "need": _round(sum(needs)) if needs or not here else None,
            "sure": _round(math.hypot(*sure)),
            "memory": agent.memory if agent else 0,
        }
        if load is not None:
            row["capacity"] = load.capacity
            if name not in unknown:
                row["used"] = _round(load.used)
                row["background"] = _round(load.background)
        yield name, row


def _measured(summary: Summary, value: float) -> float | None:
    """Return a value of a summary; None: nothing was measured yet."""
    return _round(value) if summary.count else None


def _round(value: float) -> float:
    """Return three digits: what cannot be seen is not sent again."""
    return float(f"{value:.3g}")


SPAN = 600
"""How many moments are kept, one a second: ten minutes."""


class RecentHistory:
    """Notes a moment each second, with None for what was not known then."""

    def __init__(self) -> None:
        self._moments: Records = {}
        self._before: dict[str, tuple[int, float]] = {}

    def note(self, page: Page, seen: LiveReading) -> None:
        """Note how a page is, unless that was done within this second already."""
        second = str(int(seen.at))
        if second in self._moments or seen.trouble:
            return
        self._moments[second] = {
            "cpu": {n: _share(computer) for n, computer in page["computers"].items()},
            "ages": {n: self._age(n, chain) for n, chain in page["chains"].items()},
            "late": _late(page),
        }
        while len(self._moments) > SPAN:
            del self._moments[next(iter(self._moments))]

    def moments(self) -> Records:
        """Return second [s since 1970] -> what was seen then."""
        return dict(self._moments)

    def _age(self, name: str, chain: dict[str, Any]) -> float | None:
        """Return the mean age since the last moment, as a share of the deadline."""
        uses, total = chain["uses"], chain["uses"] * chain["mean"]
        before, total_before = self._before.get(name, (uses, total))
        self._before[name] = uses, total
        if not chain["known"] or uses <= before:
            return None
        return _round((total - total_before) / (uses - before) / chain["deadline"])


def _share(computer: dict[str, Any]) -> float | None:
    used, capacity = computer.get("used"), computer.get("capacity")
    return _round(used / capacity) if capacity and used is not None else None


def _late(page: Page) -> float | None:
    """Return the largest share of deadlines that a timer misses now."""
    shares = [timer["now"] for timer in page["timers"].values() if timer["deadline"]]
    known = [share for share in shares if share is not None]
    return max(known) if known else None
