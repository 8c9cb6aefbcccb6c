"""What a person asks and does on a page: logs, what moves would change, moves, undo."""

from __future__ import annotations

import contextlib
import json
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from html import escape
from typing import Any, TypeVar

import msgspec
import yaml
from nicegui import run, ui

from poise.clock import time_of_day
from poise.errors import PoiseError, UsageError
from poise.session.render.report_page import html_table
from poise.session.render.tables import outcome_sentence, what_if_lines
from poise.session.running_robots.running import JournalEntry, Running, WhatIf
from poise.session.running_robots.running_component import RunningComponent, value_of
from poise.view.dashboard.state import Page, proposal_in, why
from poise.wire.records.request_records import OutputLine

T = TypeVar("T")
_LOG_EVERY = 0.5
_TAKEN_WITHIN = 10.0
"""The next lines are sent when the page has the last ones, or after this time [s]."""
_MOST_LINES = 200
"""How many lines of a log are shown."""


class PageActions:
    """What one page does; everything goes through the robot's manager.

    A page that may not act refuses to, and shows what it would do.
    """

    def __init__(self, running: Running, *, may_act: bool = True) -> None:
        self._running = running
        self._may_act = may_act
        self._undo: list[tuple[str, str]] = []
        self._button: Any = None
        self._place = ui.element()  # a dialog inside another would end with that one

    def place_undo(self) -> None:
        """Place the button that undoes the last move of this page."""
        self._button = ui.button("", on_click=self._undo_last)
        self._button.props('outline dense no-caps color=""')
        self._button.set_visibility(False)

    def place_stop(self) -> None:
        """Place the button that stops the robot, after a question."""
        if not self._may_act:
            return
        button = ui.button("Stop robot", on_click=self._ask_to_stop)
        button.props('outline dense no-caps color=""')

    def _ask_to_stop(self) -> None:
        says = "All its components end, on all computers, and its manager, too."
        words = "Stop the robot?", says, "Stop it", "Cancel"
        self._question(words, self._running.stop, "color=red-10")

    def _question(
        self, words: tuple[str, str, str, str], act: Callable[[], object], look: str
    ) -> None:
        """Ask before something is done: head, consequence, yes and no."""
        head, says, yes, no = words
        with self._place, _dialog() as dialog:
            ui.html(f"<h2>{escape(head)}</h2>")
            ui.label(says)
            with ui.row():
                ui.button(yes, on_click=lambda: self._call(act, dialog)).props(
                    f"no-caps {look}"
                )
                ui.button(no, on_click=dialog.close).props("no-caps outline")

    async def do_task(self, verb: str, task: str) -> None:
        """Start, pause, resume or cancel a task; before the last, ask."""
        act = partial(getattr(self._running.tasks, verb), task)
        if verb != "cancel":
            await self._call(act)
            return
        says = "It begins from its start when it is started again."
        words = f"Cancel task {task}?", says, "Cancel the task", "Keep it running"
        self._question(words, act, "")

    async def _call(self, act: Callable[[], object], dialog: Any = None) -> None:  # noqa: ANN401, NiceGUI's
        if dialog is not None:
            dialog.close()
        with self._place:
            await self._done(act)

    async def ask(self, component: str, computer: str) -> None:
        """Show what a move would change, and offer it."""
        seen = await _answered(partial(self._running.what_if, component, computer))
        if seen is None:
            return
        with self._place, _dialog() as dialog:
            ui.html(f"<h2>{escape(f'Move {component} to {computer}?')}</h2>")
            ui.html(_terms({"as it is": seen.now, "after the move": seen.then}))
            for line in what_if_lines(seen):
                refused = line.startswith("it would be refused")
                ui.label(line).classes("refused" if refused else "")
            with ui.row():
                do = "Do it anyway" if seen.breaks else "Do it"
                ui.button(do, on_click=lambda: self._do(dialog, seen)).props("no-caps")
                ui.button("Cancel", on_click=dialog.close).props("no-caps outline")

    def show_component(self, name: str, page: Page) -> None:
        """Show a component, and offer to move it: what dragging does, by keyboard."""
        known = page.get("components", {}).get(name)
        if known is None:
            return
        with self._place, _dialog() as dialog:
            ui.html(f"<h2>{escape(name)}</h2>")
            ui.label(f"{known['state']} on {known['at']}, container {known['in']}")
            if "cpu" in known:
                sure = known.get("sure")
                error = "" if sure is None else f" ± {sure:.1%}"
                ui.label(f"needs {known['cpu']:.1%}{error} of a core")
            if known.get("errors"):
                ui.label(f"{known['errors']} errors; the last: {known['error']}")
            ui.label("What if it moved to")
            with ui.row():
                for computer in page["computers"]:
                    if computer != known["at"]:
                        ui.button(
                            computer, on_click=self._asker(dialog, name, computer)
                        ).props("no-caps outline")
            ParameterFields(self._running.component(name), may_set=self._may_act)
            self._follow_log(name)
            ui.button("Close", on_click=dialog.close).props("no-caps")

    def show_entry(self, number: int, entries: Iterable[JournalEntry]) -> None:
        """Show a decision, why it was taken, and what else there was."""
        entry = next((each for each in entries if each.number == number), None)
        if entry is None:
            return
        facts = entry.facts if isinstance(entry.facts, dict) else {}
        proposal = proposal_in(facts)
        with self._place, _dialog() as dialog:
            ui.html(f"<h2>{escape(entry.what)}</h2>")
            clock = time_of_day(entry.at)
            ui.label(f"{entry.kind} at {clock}").classes("dim")
            ui.label(why(entry) or "There are no further details.")
            for step in proposal.get("steps", ()) if proposal else ():
                ui.label(f"• {_step_sentence(step)}")
            if others := facts.get("alternatives"):
                ui.label("What else could have been done:")
                ui.html(_alternatives(others)).classes("scroll")
            if proposal:
                with ui.expansion("The objective F and its parts").props("dense"):
                    terms = {"as it was": proposal["now"], "proposed": proposal["then"]}
                    ui.html(_terms(terms))
            if plain := [(n, v) for n, v in facts.items() if _is_plain(v)]:
                with ui.expansion("Recorded facts").props("dense"):
                    rows = ((escape(n), escape(_said(v))) for n, v in plain)
                    ui.html(html_table(("", ""), rows)).classes("scroll")
            ui.button("Close", on_click=dialog.close).props("no-caps")

    def _follow_log(self, component: str) -> None:
        """Show what a component wrote, and writes while the dialog is open."""
        ui.label("What it wrote")
        shown = ui.html("").classes("log")
        lines: deque[str] = deque(maxlen=_MOST_LINES)
        reader = self._running.log(component, last=_MOST_LINES, follow=True)

        async def read() -> None:
            nonlocal reader
            trouble = ""
            try:
                reading = await run.io_bound(next, reader)
            except PoiseError as error:  # the next manager tells all of it again
                reader = self._running.log(component, last=_MOST_LINES, follow=True)
                lines.clear()
                trouble = f"no log for now: {error}"
            else:
                if reading is None:  # the server ends
                    return
                lines.extend(map(_log_line, reading.lines))
                if reading.silent:
                    trouble = f"no answer from {', '.join(reading.silent)}"
            text = "\n".join([*lines, trouble] if trouble else lines) or "nothing yet"
            content = f"<pre tabindex=0>{escape(text)}</pre>"
            if content != shown.content:
                shown.content = content
                with contextlib.suppress(TimeoutError):  # on a slow link nothing queues
                    await ui.run_javascript("true", timeout=_TAKEN_WITHIN)

        ui.timer(_LOG_EVERY, read)

    def _asker(self, dialog: Any, component: str, computer: str) -> Any:  # noqa: ANN401
        async def ask() -> None:
            dialog.close()
            with self._place:  # the dialog may end first
                await self.ask(component, computer)

        return ask

    async def _do(self, dialog: Any, seen: WhatIf) -> None:  # noqa: ANN401, NiceGUI's
        dialog.close()
        with self._place:  # the dialog ends before the move does
            if await self._move(seen.component, seen.target, force=bool(seen.breaks)):
                self._undo.append((seen.component, seen.source))
        self._show_undo()

    async def _undo_last(self) -> None:
        if not self._button.enabled:
            return
        self._button.disable()  # or a double click would undo two moves
        last = self._undo.pop()
        if not await self._move(*last, force=True):
            self._undo.append(last)
        self._button.enable()
        self._show_undo()

    def _show_undo(self) -> None:
        self._button.set_visibility(bool(self._undo))
        if self._undo:
            component, source = self._undo[-1]
            self._button.text = f"Undo: {component} back to {source}"

    async def _move(self, component: str, computer: str, *, force: bool) -> bool:
        report = await self._done(
            partial(self._running.move, component, computer, force=force)
        )
        if report is not None:
            ui.notify(outcome_sentence(report), color="green-10")
        return report is not None

    async def _done(self, act: Callable[[], T]) -> T | None:
        """Do what changes the robot; None: it was refused, as the page says."""
        if self._may_act:
            return await _answered(act)
        _complain(
            "this page is read-only: `poise dashboard` printed the address of one "
            "that may act, too"
        )
        return None


async def _answered(ask: Callable[[], T]) -> T | None:
    """Return what the robot answers; None: the page says what went wrong."""
    try:
        answer: T | None = await run.io_bound(ask)
    except PoiseError as error:
        _complain(error)
        return None
    return answer


@contextlib.contextmanager
def _dialog() -> Iterator[Any]:
    """Open a dialog with what is made in the ``with`` block; it ends when closed."""
    with ui.dialog() as dialog, ui.card().classes("ask"):
        yield dialog
    dialog.on("hide", dialog.delete)
    dialog.open()


def _complain(error: object) -> None:
    ui.notify(str(error), color="red-10", multi_line=True, timeout=10_000)


def _log_line(line: OutputLine) -> str:
    at = time_of_day(line.at / 1e9)
    return f"{at} {line.text}"


def _step_sentence(step: dict[str, Any]) -> str:
    source, target = step.get("source"), step.get("target")
    if source and target:
        return f"{step['component']} moves from {source} to {target}"
    return f"{step['component']} " + (
        f"starts on {target}" if target else f"ends on {source}"
    )


def _is_plain(value: object) -> bool:
    several = value if isinstance(value, list) else [value]
    return bool(several) and all(isinstance(v, str | int | float) for v in several)


def _said(value: Any) -> str:  # noqa: ANN401, JSON's
    if isinstance(value, list):
        return ", ".join(map(_said, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _alternatives(others: list[dict[str, Any]]) -> str:
    heads = ("", "F", "cores too little", "cost", "limits that it breaks")
    cells = [
        (
            other["what"],
            f"{other['total']:.4g}",
            f"{other['short']:.2f}",
            f"{other['cost']:.2f}",
            other["breaks"] or "none",
        )
        for other in others
    ]
    return html_table(heads, (map(escape, row) for row in cells))


def _terms(columns: dict[str, Any]) -> str:
    terms = {name: msgspec.to_builtins(column) for name, column in columns.items()}
    names = {"total": "F"} | {n: n for n in ("communication", "balance", "move")}
    if any(values["time"] for values in terms.values()):
        names["time"] = "time"
    rows = (
        (says, *(f"{values[term]:.4g}" for values in terms.values()))
        for term, says in names.items()
    )
    return html_table(("", *terms), rows)


class ParameterFields:
    """A field for each parameter of a component; nothing where it has none."""

    def __init__(self, component: RunningComponent, *, may_set: bool) -> None:
        self._component = component
        self._may_set = may_set
        self._place = ui.column()
        self._known: dict[str, Any] = {}
        self._fields: dict[str, Any] = {}
        ui.timer(0.0, self._fill, once=True)

    async def _fill(self) -> None:
        try:
            self._known = await run.io_bound(self._component.parameters) or {}
        except PoiseError as error:
            with self._place:
                ui.label(f"Its parameters are not known: {error}").classes("refused")
            return
        if not self._known:
            return
        with self._place:
            ui.label("Its parameters")
            for name, value in self._known.items():
                field = ui.input(name, value=_text(value)).props("dense outlined")
                field.set_enabled(self._may_set)
                self._fields[name] = field
            if self._may_set:
                ui.button("Set", on_click=self._set).props("no-caps outline")

    async def _set(self) -> None:
        try:
            changes = {
                name: value_of(field.value)
                for name, field in self._fields.items()
                if field.value != _text(self._known[name])
            }
        except UsageError as error:
            _complain(error)
            return
        if not changes:
            ui.notify("Nothing was changed")
            return
        took = await _answered(partial(self._component.set_parameters, changes))
        if took is None:
            return
        self._known |= took
        for name, value in took.items():
            self._fields[name].value = _text(value)
        said = ", ".join(f"{name} = {_text(value)}" for name, value in took.items())
        ui.notify(f"{self._component.name} has {said}", color="green-10")


def _text(value: object) -> str:
    """Return a value as a robot file has it, in one line."""
    text = yaml.safe_dump(
        value, default_flow_style=True, allow_unicode=True, width=math.inf
    )
    line = text.removesuffix("\n").removesuffix("\n...")
    return json.dumps(value, ensure_ascii=False) if "\n" in line else line
