"""What simulations showed, as records that print themselves."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct, structs
from rich.console import RenderableType

from poise.session.pages.simulation_page import (
    comparison_page,
    simulation_page,
    simulation_picture,
)
from poise.session.render.printable import Printable
from poise.session.render.simulation_tables import (
    comparison_parts,
    ended_early,
    simulation_parts,
    verdict,
)
from poise.simulation.simulation_report import SimulationReport


class Simulation(Printable, SimulationReport, frozen=True, kw_only=True):
    """A simulated robot. It prints itself as tables, in a terminal and in a notebook.

    `seconds` is less than `asked` when it was ended early, as by Ctrl-C.
    """

    @classmethod
    def of(cls, report: SimulationReport) -> Simulation:
        """Return a report as one that prints itself."""
        return cls(**structs.asdict(report))

    @property
    def is_early(self) -> bool:
        """Whether it was ended before the time that was asked for."""
        return ended_early(self)

    @property
    def failed(self) -> bool:
        """Whether a promise of Poise did not hold."""
        return bool(self.violations)

    @property
    def verdict(self) -> str:
        """What came of it, in one sentence."""
        return verdict(self)

    def parts(self) -> tuple[RenderableType, ...]:
        """Return what is printed."""
        return tuple(simulation_parts(self))

    def picture(self) -> str:
        """Return the computers' CPU over time, with faults, moves and outages."""
        return simulation_picture(self)

    def page(self) -> str:
        """Return an HTML page that needs no other file, and no network."""
        return simulation_page(self, self.html())


class SimulationComparison(Printable, Struct, frozen=True, kw_only=True):
    """The same robot under the same faults, placed by several methods.

    Parameters
    ----------
    results
        Method -> what came of it.
    without
        Method -> why there is no result: no placement, or the robot did not come up.
    """

    results: Mapping[str, Simulation]
    without: Mapping[str, str] = {}

    @property
    def failed(self) -> bool:
        """Whether a promise of Poise did not hold, or a method has no result."""
        return bool(self.without) or any(each.failed for each in self.results.values())

    def parts(self) -> tuple[RenderableType, ...]:
        """Return what is printed."""
        return tuple(comparison_parts(self.results, self.without))

    def page(self) -> str:
        """Return an HTML page that needs no other file, and no network."""
        return comparison_page(self.results, self.html())
