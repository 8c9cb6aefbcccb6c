"""The parameters of a component in a dialog: how they are, and fields to set them."""

from __future__ import annotations

from typing import Any

import yaml
from nicegui import run, ui

from poise.errors import PoiseError
from poise.session.running_robots.running_component import RunningComponent


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
            values = {n: yaml.safe_load(f.value) for n, f in self._fields.items()}
        except yaml.YAMLError as error:
            _complain(f"that is no value: {error}")
            return
        changes = {n: v for n, v in values.items() if v != self._known[n]}
        if not changes:
            ui.notify("All are as they were")
            return
        try:
            took = await run.io_bound(self._component.set_parameters, changes)
        except PoiseError as error:
            _complain(str(error))
            return
        self._known |= took
        for name, value in took.items():
            self._fields[name].value = _text(value)
        said = ", ".join(f"{name} = {_text(value)}" for name, value in took.items())
        ui.notify(f"{self._component.name} has {said}", color="green-10")


def _complain(text: str) -> None:
    ui.notify(text, color="red-10", multi_line=True, timeout=10_000)


def _text(value: object) -> str:
    """Return a value as a robot file has it, in one line."""
    text = yaml.safe_dump(value, default_flow_style=True, allow_unicode=True)
    return text.removesuffix("\n").removesuffix("\n...")
