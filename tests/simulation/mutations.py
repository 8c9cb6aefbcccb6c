"""Asks whether the simulator finds defects that Poise had, and mutations of its code.

    python -m tests.simulation.mutations                 # all, one after the other
    python -m tests.simulation.mutations no-revoke --seeds 200
    python -m tests.simulation.mutations token --first 20 --seeds 5

Each runs in a process of its own: seeds one after the other until one fails, whose run
is shrunk. The exit code is 1 when one is not found.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any, cast

from msgspec import structs

from poise.manage.adaptation import placement_responders
from poise.manage.agent_connections import claims
from poise.manage.agent_connections.agents import Agents
from poise.manage.agent_connections.reports import AgentReports
from poise.manage.deploy import desired_state, takeover
from poise.manage.deploy.adoption import joined_by
from poise.manage.deploy.desired import Desired
from poise.manage.deploy.desired_state import DesiredState
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.deploy.reconciler import Reconciler
from poise.manage.migration.coordinator import Migration
from poise.manage.migration.migration_rounds import MigrationRounds
from poise.manage.observe.troubles import ManagerParts
from poise.manage.tasks.prefetch import Prefetcher
from poise.runtime.agent import fence
from poise.runtime.agent.fence import Fence, Lease
from poise.runtime.agent.heartbeat_exchange import HeartbeatExchange
from poise.runtime.supervision.supervisor import Supervisor
from poise.simulation.robot.modelled_container import SimulatedContainer
from tests.simulation.conftest import small_scenario
from tests.simulation.shrink import Shrunk
from tests.simulation.simulated_run import simulate

SECONDS = 120.0
MOST_SEEDS = 2000
Defects = Mapping[str, tuple[str, Callable[[], None]]]


def main() -> int:
    """Look for the defects that the command line names; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="defects; none: all")
    parser.add_argument("--seeds", type=int, default=MOST_SEEDS)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--shrink", type=int, default=40, help="runs, at most")
    parser.add_argument("--here", action="store_true", help="in this process")
    asked = parser.parse_args()
    if asked.here:
        return look_for(asked.names[0], asked.first, asked.seeds, asked.shrink)
    missed = 0
    for name in asked.names or DEFECTS:
        words = "-m", "tests.simulation.mutations", name, "--here"
        done = subprocess.run(
            [
                *(sys.executable, *words, "--seeds", str(asked.seeds)),
                *("--first", str(asked.first), "--shrink", str(asked.shrink)),
            ],
            stderr=subprocess.DEVNULL,
            check=False,
        )
        missed += done.returncode
    print(f"{missed} not found")
    return bool(missed)


def look_for(name: str, first: int, seeds: int, most: int) -> int:
    """Run seeds until one shows a defect; print one line of the table."""
    what, break_it = DEFECTS[name]
    break_it()
    scenario, began = small_scenario(SECONDS), time.monotonic()
    for seed in range(first, first + seeds):
        outcome = simulate(scenario, seed)
        if outcome.failure and not _fails_without(seed):
            shrunk = Shrunk(scenario, outcome)
            shrunk.shrink(most)
            found = shrunk.outcome
            faults = ", ".join(fault.kind for fault in found.faults) or "none"
            print(
                f"| {what} | {seed + 1} | {found.failure} | {len(found.faults)} "
                f"({faults}) | {len(found.trace)} | {time.monotonic() - began:.0f} s |",
                flush=True,
            )
            return 0
    print(f"| {what} | not in {seeds} | | | | {time.monotonic() - began:.0f} s |")
    return 1


def _fails_without(seed: int) -> bool:
    """Return whether a seed fails also without the defect, in another process."""
    words = "-m", "tests.simulation", "--seed", str(seed)
    done = subprocess.run([sys.executable, *words], capture_output=True, check=False)
    return bool(done.returncode)


def _put(owner: object, name: str, value: object) -> Callable[[], None]:
    return lambda: setattr(owner, name, value)


def _key_error_for_missing_status() -> None:
    def obey(self: Any, computer: str) -> Any:
        with self._changed:
            return self._claims.is_obeyed(self._statuses[computer])

    setattr(Agents, "obey", obey)


def _bug_ends_the_robot() -> None:
    def run(_: Any, __: str, work: Callable[[], object], **___: Any) -> object:
        return work()

    def fails_once_lost(self: Any, *args: Any) -> None:
        if self._run.agents.out_of_reach():
            raise KeyError("a computer is lost")
        update(self, *args)

    update = Prefetcher.update
    setattr(ManagerParts, "run", run)
    setattr(Prefetcher, "update", fails_once_lost)


def _unknown_is_no() -> None:
    setattr(takeover, "WITNESS_LIMIT", 0.0)
    setattr(takeover, "_end_containers", lambda *_: None)


def _no_generation_at_takeover() -> None:
    def adopt(self: Any, kept: Any, last: Any, tasks: Any, held: Any) -> None:
        self._epochs = dict(last)
        self.desired = Desired(placed=dict(kept), tasks=tasks, held=held)

    setattr(DesiredState, "adopt", adopt)


def _late_page() -> None:
    extend = SimulatedContainer.extend_lease

    def later(self: Any, until: float) -> None:
        extend(self, until + 3.0)

    setattr(SimulatedContainer, "extend_lease", later)


def _stale_adopted() -> None:
    def joined(*args: Any) -> Desired:
        known: Any = joined_by
        return cast("Desired", known(*args[:-1], ()))

    setattr(desired_state, "joined_by", joined)


def _lost_token_is_an_end() -> None:
    note = Fence.note_liveliness

    def ended(self: Any, key: str, *, is_there: bool, **_: Any) -> None:
        note(self, key, is_there=is_there, has_ended=True)

    setattr(Fence, "note_liveliness", ended)


def _lease_of_another_manager() -> None:
    def age(self: Any, now: float) -> Any:
        direct = self.managed(now)
        if direct is None:
            return 0.0
        others = [c for name in self._others if (c := self._contacts.get(name))]
        ages = [
            now - each.acked + each.last.managed
            for each in others
            if each.acked is not None and each.last.managed is not None
        ]
        return min([direct, *ages, self._unheard(now)])

    setattr(Lease, "age", age)
    setattr(HeartbeatExchange, "note_lapsed", lambda _: None)


def _same_epoch() -> None:
    def next_epoch(self: Any, component: str) -> int:
        epoch: int = self._epochs.setdefault(component, self._last_epoch + 1)
        return epoch

    setattr(DesiredState, "next_epoch", next_epoch)


def _told_once() -> None:
    def is_sent(_: Any, agent: Any, *__: Any) -> Any:
        return agent.sent is not None

    setattr(Reconciler, "_is_sent", is_sent)


def _no_roll_back() -> None:
    aiming = Desired.aiming

    def without(self: Desired, goal: Any, names: Any) -> Desired:
        return self if goal == "active" else aiming(self, goal, names)

    setattr(MigrationRounds, "roll_back", lambda _: [])
    setattr(Desired, "aiming", without)


def _claims_by_force() -> None:
    claim = Fence.claim

    def by_force(self: Fence, asked: Any, token: int) -> Any:
        return claim(self, structs.replace(asked, take_over=True), token)

    setattr(Fence, "claim", by_force)


def _replaced_goes_on() -> None:
    def gives_way_to(manager: Any, claimed: Any, _: Any, statuses: Any) -> Any:
        return known(manager, claimed, {}, statuses)

    known = claims.gives_way_to
    setattr(claims, "gives_way_to", gives_way_to)


def _lease_of_first_heartbeat() -> None:
    begin = Lease.begin

    def later(self: Lease, others: Any, manager: Any, began: Any = None) -> None:
        began = None if began is not None and began > 0 else began
        begin(self, others, manager, began)

    setattr(Lease, "begin", later)


def _commit_that_rolls_back() -> None:
    original = Migration._switch

    def switch(*args: Any) -> str:
        return original(*args) and ""

    setattr(Migration, "_switch", switch)


DEFECTS: Defects = {
    # defects that Poise had
    "page": ("containers act after their agent's lease", _late_page),
    "two-sides": (
        "two managers, two sides of a cut",
        _put(takeover, "components_to_hold", lambda *_: frozenset()),
    ),
    "bug-ends": ("an exception in the loop ends the robot", _bug_ends_the_robot),
    "key-error": (
        "KeyError for an agent without a status",
        _key_error_for_missing_status,
    ),
    "unknown-is-no": ("unknown witness counts as no", _unknown_is_no),
    "generation": ("a take-over that tells generation 0", _no_generation_at_takeover),
    "claim-goes-on": (
        "what ran for another manager goes on at a claim",
        _put(Fence, "lapse", lambda _: None),
    ),
    "stale": ("stale incarnations are adopted at a heal", _stale_adopted),
    "token": ("a lost token is taken for the manager's end", _lost_token_is_an_end),
    "other-lease": (
        "another manager's agents extend the lease of an agent that was started again",
        _lease_of_another_manager,
    ),
    "no-witness": (
        "a take-over rolls back each half-done move, and asks no container",
        _put(takeover, "_committed", lambda *_: frozenset()),
    ),
    "stale-disk": (
        "an agent starts what its disk says, however old that is",
        _put(Supervisor, "_left", lambda _, spec: spec),
    ),
    "for-ever-silent": (
        "an agent that obeys another manager counts as out of reach",
        _put(Agents, "store_status", AgentReports.store_status),
    ),
    "lost-commit": (
        "a manager that was replaced says how its move ended",
        _put(Migration, "_raise_on_successor", lambda _: None),
    ),
    "replaced-goes-on": (
        "a manager that was replaced goes on once its successor is gone",
        _replaced_goes_on,
    ),
    "late-lease": (
        "a lease begins with the first heartbeat of a manager that claims",
        _lease_of_first_heartbeat,
    ),
    "relayed-lease": (
        "other agents extend a lease that ended while its agent stood still",
        _put(Lease, "note_stall", lambda *_: None),
    ),
    "untold-commit": (
        "a manager says that it committed what no agent was told",
        _put(Migration, "_is_known", lambda _: True),
    ),
    # mutations
    "long-lease": ("agents keep leases for 2 s", _put(fence, "LEASE", 2.0)),
    "no-revoke": (
        "what was lost starts before its lease has ended",
        _put(LiveRobot, "revoke_leases", lambda *_: None),
    ),
    "no-gap": (
        "an agent that went on after its lease does not know",
        _put(HeartbeatExchange, "note_lapsed", lambda _: None),
    ),
    "same-epoch": ("incarnations have the same epoch", _same_epoch),
    "told-once": ("agents are told only once", _told_once),
    "no-roll-back": ("a move is not rolled back", _no_roll_back),
    "no-buffer": (
        "senders do not buffer during a move",
        _put(MigrationRounds, "_buffer", lambda _: []),
    ),
    "no-drain": (
        "a state is sent while messages are under way",
        _put(MigrationRounds, "_drain_channels", lambda *_: []),
    ),
    "false-commit": ("a failed move counts as committed", _commit_that_rolls_back),
    "any-claim": ("an agent obeys whoever claims it", _claims_by_force),
    "no-failover": (
        "what was lost is not started again",
        _put(placement_responders, "start_together", lambda *_: False),
    ),
}


if __name__ == "__main__":
    sys.exit(main())
