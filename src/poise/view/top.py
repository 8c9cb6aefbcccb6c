"""A running robot in a terminal: `poise top` (extra `top`)."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, ClassVar

from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding
from textual.widgets import DataTable, Footer, Static

from poise.clock import time_of_day
from poise.session.running_robots.running import Status
from poise.units import format_bytes
from poise.view.robot_view import (
    ComponentRow,
    ComputerRow,
    ConnectorRow,
    Reader,
    RobotView,
)

_BAR, _SHORT_BAR, _NARROW = 10, 4, 80
"""Length of bars, and of those in a terminal narrower than this [characters]."""
_LEAST_NAME = 20
"""Names are not shortened to less [characters]."""
_GAP = 2
"""Between the columns of a table [characters]."""
_PATIENCE = 3.0
"""A manager that takes longer to answer is said to be silent [s]."""
_FULL, _HIGH = 1.0, 0.8
_MOST_LINES = 4
_COLUMNS = {
    "computers": {
        "computer": "name",
        "CPU": "cpu",
        "memory": "memory",
        "components": "components",
    },
    "components": {
        "component": "name",
        "computer": "computer",
        "state": "state",
        "CPU": "cpu",
        "missed/s": "missed",
        "errors": "errors",
    },
    "connectors": {
        "connector": "name",
        "kind": "kind",
        "rate/s": "rate",
        "traffic/s": "traffic",
        "drops": "drops",
        "errors": "errors",
    },
}
"""Table -> its columns, and the field that each is sorted by."""
_COLOURS = {"wrong": "red", "failed": "red", "right": "green", "decided": "bold"}


_UNKNOWN = Text("?", "red", justify="right")


class Top(App[None]):
    """Shows a robot until `q`."""

    TITLE = "poise top"
    CSS = """
    #head { height: auto; max-height: 3; }
    #computers { height: auto; max-height: 30%; }
    #components { height: 1fr; }
    #connectors { height: 1fr; }
    #decisions { height: auto; max-height: 4; color: $text-muted;
        text-wrap: nowrap; text-overflow: ellipsis; }
    DataTable > .datatable--header { text-style: bold; }
    DataTable:focus > .datatable--header { text-style: bold reverse; }
    """
    BINDINGS: ClassVar[list[Any]] = [
        Binding("q", "quit", "quit"),
        Binding("s", "sort", "sort by next column"),
        Binding("r", "turn", "other way round"),
        Binding("tab", "app.focus_next", "next table"),
    ]
    ENABLE_COMMAND_PALETTE = False

    def __init__(self, read: Callable[[], Status], every: float = 1.0) -> None:
        super().__init__()
        self._read = read
        self._every = every
        self._reader = Reader()
        self._view: RobotView | None = None
        self._silent = ""
        self._asked_at: float | None = None
        self._sorted = dict.fromkeys(_COLUMNS, 0)
        self._turned = dict.fromkeys(_COLUMNS, False)

    def compose(self) -> ComposeResult:
        """Yield the parts of the screen, from top to bottom."""
        yield Static("waiting for the robot ...", id="head", markup=False)
        for name in _COLUMNS:
            yield DataTable(id=name, cursor_type="row")
        yield Static(id="decisions", markup=False)
        yield Footer()

    def on_mount(self) -> None:
        """Begin to poll."""
        self.query_one("#components").focus()
        self._poll()
        self.set_interval(self._every, self._poll)

    def action_sort(self) -> None:
        """Sort the table in focus by its next column."""
        name = self._focused_table()
        self._sorted[name] = (self._sorted[name] + 1) % len(_COLUMNS[name])
        self._show()

    def action_turn(self) -> None:
        """Sort the table in focus the other way round."""
        name = self._focused_table()
        self._turned[name] = not self._turned[name]
        self._show()

    def _focused_table(self) -> str:
        name = getattr(self.focused, "id", None)
        return name if name in _COLUMNS else "components"

    def _poll(self) -> None:
        """Read the robot, unless the last answer is still awaited."""
        now = time.monotonic()
        if self._asked_at is None:
            self._asked_at = now
            self.run_worker(self._read_status, thread=True)
        elif now - self._asked_at > _PATIENCE:
            self._silent = f"since {now - self._asked_at:.0f} s"
            self.query_one("#head").update(self._head())

    def _read_status(self) -> None:
        view, silent = None, ""
        try:
            view = self._reader.update(self._read(), time.monotonic())
        except Exception as error:  # noqa: BLE001, it is shown, and the next poll is soon
            silent = str(error)
        self.call_from_thread(self._show_view, view, silent)

    def _show_view(self, view: RobotView | None, silent: str) -> None:
        self._view, self._silent = view or self._view, silent
        self._asked_at = None
        self._show()

    def _show(self) -> None:
        self.query_one("#head").update(self._head())
        view = self._view
        if view is None:
            return
        bar = _BAR if self.size.width >= _NARROW else _SHORT_BAR
        self._fill("computers", view.computers, partial(computer_cells, bar=bar))
        self._fill("components", view.components, component_cells)
        self._fill("connectors", view.connectors, connector_cells)
        lines = Text()
        for entry in view.status.recent[-_MOST_LINES:]:
            clock = time_of_day(entry.at)
            lines.append(f"{clock} {entry.what}\n", _COLOURS.get(entry.kind, ""))
        lines.rstrip()
        self.query_one("#decisions").update(lines)

    def _head(self) -> Text:
        if self._silent:
            old = ", below is what was known last" if self._view else ""
            return Text(f"no answer{old}: {self._silent}", "red")
        if self._view is None:
            return Text("waiting for the robot ...")
        status = self._view.status
        head = Text(f"robot '{status.robot}', task '{status.task}': ")
        if unknown := status.not_known():
            head.append(f"not known: {', '.join(sorted(unknown))}; ", "red")
        elif not status.deviations:
            return head.append("as the robot file says", "green")
        if not status.deviations:
            return head
        more = len(status.deviations) - 1
        head.append(status.deviations[0].what, "red")
        return head.append(f" and {more} more" if more else "", "red")

    def _fill(
        self, name: str, rows: Sequence[Any], cells: Callable[[Any], Sequence[Any]]
    ) -> None:
        """Fill a table, and leave cursor and scrolling where they are."""
        table = self.query_one(f"#{name}")
        place, scrolled = table.cursor_row, table.scroll_y
        table.clear(columns=True)
        column, is_turned = self._sorted[name], self._turned[name]
        arrow = "▼" if is_turned else "▲"
        for number, title in enumerate(_COLUMNS[name]):
            table.add_column(f"{title} {arrow}" if number == column else title)
        by = [*_COLUMNS[name].values()][column]
        # numbers largest first, names in their order
        ordered = sorted(
            rows, key=lambda row: _order(getattr(row, by)), reverse=is_turned
        )
        titles = [*_COLUMNS[name]]
        for line in _fitting([cells(row) for row in ordered], titles, self.size.width):
            table.add_row(*line)
        table.move_cursor(row=place, scroll=False)
        table.scroll_to(y=scrolled, animate=False)


def _order(value: object) -> Any:  # noqa: ANN401, of one type in a column
    if value is None:  # what is not known comes first
        return float("-inf")
    return -value if isinstance(value, int | float) else value


def _fitting(
    lines: Sequence[Sequence[Any]], titles: Sequence[str], width: int
) -> Iterator[Sequence[Any]]:
    """Yield a table's lines with names so short that the other columns are seen."""
    rest = 0
    for number, title in enumerate(titles[1:], 1):
        longest = max((len(line[number]) for line in lines), default=0)
        rest += max(longest, len(title)) + _GAP
    room = max(_LEAST_NAME, width - rest - 2 * _GAP - len(" ▼"))
    for name, *others in lines:
        yield _shortened(name, room), *others


def _shortened(name: str, room: int) -> str:
    """Return a name without its middle where it is too long; both ends tell most."""
    if len(name) <= room:
        return name
    head = room // 2
    return f"{name[:head]}…{name[len(name) - (room - head - 1) :]}"


def computer_cells(row: ComputerRow, bar: int = _BAR) -> tuple[Any, ...]:
    """Return what is shown of a computer."""
    # agents alone do not know what their computers have
    most = f"/{row.cores:.3g}" if row.cores else ""
    if row.cpu is None or row.memory is None:
        age = "" if row.age is None else f", last news {row.age:.0f} s ago"
        return (row.name, Text(f"not known{age}", "red"), _UNKNOWN, str(row.components))
    return (
        row.name,
        _bar(row.cpu, row.cores, f"{row.cpu:.2f}{most}", bar),
        _bar(row.memory, row.most_memory, format_bytes(row.memory), bar),
        str(row.components),
    )


def component_cells(row: ComponentRow) -> tuple[Any, ...]:
    """Return what is shown of a component."""
    is_well = row.state in {"active", "inactive"}
    return (
        row.name,
        row.computer,
        Text(row.state, "" if is_well else "red"),
        _UNKNOWN if row.cpu is None else Text(f"{row.cpu:.1%}", justify="right"),
        _UNKNOWN
        if row.missed is None
        else Text(f"{row.missed:.1f}" if row.missed else "", "red", justify="right"),
        Text(str(row.errors or ""), "red", justify="right"),
    )


def _kind(row: ConnectorRow) -> Text:
    if not row.kind:
        return Text("not known", "red")
    return Text(row.kind) if row.is_joined else Text("not joined", "red")


def connector_cells(row: ConnectorRow) -> tuple[Any, ...]:
    """Return what is shown of a connector."""
    return (
        row.name,
        _kind(row),
        _UNKNOWN if row.rate is None else Text(f"{row.rate:.1f}", justify="right"),
        Text(format_bytes(row.traffic) if row.traffic else "", justify="right"),
        Text(str(row.drops or ""), "red", justify="right"),
        Text(str(row.errors or ""), "red", justify="right"),
    )


def _bar(used: float, capacity: float, text: str, length: int) -> Text:
    """Return a bar and a text; what is too much is also said by a sign."""
    share = used / capacity if capacity > 0 else 0.0
    full = min(length, round(share * length))
    sign = "!" if share > _FULL else " "
    colour = "red" if share > _FULL else "yellow" if share > _HIGH else "green"
    rest = "░" * (length - full), "dim"
    return Text.assemble(("█" * full, colour), rest, f"{sign}{text}")
