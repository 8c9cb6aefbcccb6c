"""How old the data of chains was, for people."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise

from rich.table import Table

from poise.manage.observe.chains import ChainReport
from poise.session.render.shared_tables.columns import table
from poise.units import format_seconds


def chain_tables(chains: Iterable[ChainReport]) -> Iterator[Table]:
    """Yield a row for each chain, if there is one: the age of its data when used."""
    names = "chain, data age", "deadline", "used", "missed", "median", "p99", "maximum"
    rows = table(*names, "±", "median by step")
    for chain in chains:
        age, head = chain.age, (chain.name, format_seconds(chain.deadline))
        if not age.count:
            rows.add_row(*head, "0")
            continue
        ages = map(format_seconds, (age.median, age.p99, age.maximum, chain.error))
        share = f"{chain.missed / age.count:.1%}"
        rows.add_row(*head, str(age.count), share, *ages, _steps(chain))
    if rows.row_count:
        yield rows


def _steps(chain: ChainReport) -> str:
    """Return how much older the data is at each component than at the one before."""
    return ", ".join(
        f"{next_.component} {format_seconds(max(0.0, next_.age.median - one))}"
        for one, next_ in (
            (before.age.median, after) for before, after in pairwise(chain.hops)
        )
    )
