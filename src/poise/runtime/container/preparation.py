"""Imports and constructs a component on a thread of its own.

Nobody waits for it: neither the control thread nor other components, however long an
import takes.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from poise.clock import ComponentClock
from poise.priority import give_way
from poise.runtime.component.component import Component
from poise.runtime.component.error_report import told
from poise.runtime.component.implementation import find
from poise.runtime.hosting.command_line import CommandLine
from poise.runtime.hosting.runner import Runner
from poise.wire.records.deployment import ComponentSpec, ComponentStatus

log = logging.getLogger(__name__)


def implementation_of(spec: ComponentSpec, folder: str) -> type[Component]:
    """Return the class to run; Poise's own may have ports by their parameters."""
    if spec.command:
        own = {"command": spec.command, "folder": folder or "."}
        return type("CommandLine", (CommandLine,), own)
    found = find(spec.implementation, folder)
    special = getattr(found, "__poise_specialised__", None)
    return special(spec.parameters, folder) if special else found


class Preparation:
    """A component that is not there yet.

    Parameters
    ----------
    folder
        Where its implementation is imported from.
    gives_way
        Whether it leaves the CPU to all other threads.
    on_change
        Called when it is done, and by the runner at every change of state; must not
        block.

    Attributes
    ----------
    runner
        The component, not started yet; None until it is done, and when it failed.
    error
        Why it failed.
    """

    def __init__(
        self,
        spec: ComponentSpec,
        folder: str,
        clock: ComponentClock,
        on_change: Callable[[], None],
        *,
        gives_way: bool,
    ) -> None:
        self.spec = spec
        self.runner: Runner | None = None
        self.error = ""
        self._folder = folder
        self._clock = clock
        self._on_change = on_change
        self._gives_way = gives_way
        threading.Thread(
            target=self._main, name=f"import {spec.name}"[:15], daemon=True
        ).start()

    def is_done(self) -> bool:
        """Return whether there is a runner or an error."""
        return self.runner is not None or bool(self.error)

    def status(self) -> ComponentStatus:
        """Return the component's status so far."""
        return ComponentStatus(
            name=self.spec.name,
            epoch=self.spec.epoch,
            state="failed" if self.error else "unconfigured",
            error=self.error,
            errors=1 if self.error else 0,
        )

    def _main(self) -> None:
        if self._gives_way:
            give_way()
        spec, asked_at = self.spec, self._clock.now()
        try:
            implementation = implementation_of(spec, self._folder)
            runner = Runner(spec, implementation, self._clock, self._on_change)
            runner.asked_at = asked_at
            self.runner = runner
        # it is the user's: it may raise anything
        except (Exception, SystemExit) as error:  # noqa: BLE001
            self.error = told(error) or repr(error)
            log.error("component '%s' cannot start: %s", spec.name, self.error)  # noqa: TRY400, told
        self._on_change()
