"""What should run on a robot: the one owner of that record. Waits for no agent."""

from __future__ import annotations

import itertools
import secrets
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial

from msgspec import structs
from msgspec.msgpack import encode

from poise.clock import Clock, SystemClock, wall_time
from poise.estimate.code_version import version_of
from poise.manage.agent_connections.agents import Agents
from poise.manage.agent_connections.statuses import gateways
from poise.manage.deploy.adoption import as_committed, differences, found_in, joined_by
from poise.manage.deploy.deployment_layout import DeploymentLayout
from poise.manage.deploy.desired import Desired, Incarnation, OtherCode, difference
from poise.manage.deploy.reconciler import JoiningComputer, Reconciler
from poise.manage.journal import Journal
from poise.manage.observe.deviations import Deviation, last_numbers
from poise.manage.observe.troubles import ManagerParts
from poise.manage.tasks.task_reports import Switches
from poise.model.check.allowed_computers import allowed_computers
from poise.model.robot import Robot
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.request_records import CheckpointCopy, Claimed


class DesiredState:
    """Holds what should run, and lets agents know."""

    def __init__(
        self,
        robot: Robot,
        placement: Mapping[str, str],
        agents: Agents,
        journal: Journal,
        folder: str,
        *,
        weigh: bool = False,
        clock: Clock | None = None,
    ) -> None:
        self.robot = robot
        self.agents = agents
        self.journal = journal
        self.layout = DeploymentLayout(
            robot, folder, weigh=weigh, code_version=version_of
        )
        self.clock = clock or SystemClock()
        self.faults_before = last_numbers(agents.statuses())
        self.switches = Switches()
        self.check: Callable[[], object] = lambda: None
        """Called at all news while agents are waited for; may raise to end that."""
        self.is_over = threading.Event()
        self._epochs: dict[str, int] = {}
        self._last_epoch = -1
        self.desired = Desired(
            placed={
                name: Incarnation(
                    component=name, computer=computer, epoch=self.next_epoch(name)
                )
                for name, computer in placement.items()
            }
        )
        """What should run; any thread may read it, and only `commit` replaces it."""
        self.parts = ManagerParts(
            journal, self.clock, self.release, self.is_over.is_set
        )
        """What runs the parts of the manager's loop."""
        self.reconciler = Reconciler(agents, self.clock, self._note_claimed)
        self.claimed: set[str] = set()
        """The computers that this manager has claimed: it knows their components."""
        self._joining: dict[str, JoiningComputer] = {}
        self.doubted: frozenset[tuple[str, int]] = frozenset()
        """What may never have run, as `joined_by` takes it."""
        self.batch_numbers = itertools.count(secrets.randbits(48))
        """Tell the batches of migration steps apart, from other managers' too."""
        self._gateways: dict[str, str] = {}
        self._deployments: Mapping[str, Deployment] = {}
        self._deployed_for: object = None
        self.is_left = False
        """Whether it is left to another manager, or was stopped."""
        self.lost_states: dict[str, Deviation] = {}
        """Component -> how it lost its state when it was last started again."""

    @property
    def placed(self) -> Mapping[str, Incarnation]:
        """Component -> its authoritative incarnation."""
        return self.desired.placed

    @property
    def prefetched(self) -> Mapping[str, Incarnation]:
        """Component -> its idle incarnation, to be active soon."""
        return self.desired.prefetched

    def prepared(self) -> dict[str, str]:
        """Return idle component -> computer; from any thread."""
        return {name: idle.computer for name, idle in self.prefetched.items()}

    def placement(self) -> dict[str, str]:
        """Return component -> computer, as it is now; from any thread."""
        return self.desired.placement()

    def begin_with(self, tasks: bytes) -> None:
        """Let the first commit say the tasks: this manager may be killed then."""
        self.desired = structs.replace(self.desired, tasks=tasks)

    def commit(self, desired: Desired, why: str, *, tell_later: bool = False) -> None:
        """Let something else run from now on: journal it, and tell agents.

        `desired`: made from `self.desired`; its generation is overwritten.
        """
        before = self.desired
        statuses = self.agents.statuses()
        if desired != before:
            # later than any that the agents ever saw, from whatever manager
            seen = [status.generation for status in statuses.values()]
            self.desired = structs.replace(
                desired,
                generation=max(desired.generation, *seen, 0) + 1,
                other_code=self._other_code(desired),
                ended=self._ended(desired),
            )
            if changes := difference(before, desired):
                self.journal.note("desired", why, changes=changes)
            settled = self.desired.settled()
            self.agents.checkpoints.keep_only({n: i.epoch for n, i in settled.items()})
        if not tell_later:
            self.reconcile()

    def reconcile(self) -> None:
        """Bring the agents a step nearer to what should run; never raises."""
        if not self.is_left:
            self.parts.run("bring agents to what should run", self._reconcile)

    def release(self, why: str) -> None:
        """Let what is placed go on, without any change under way: that broke."""
        self.commit(self.desired.released(), why)

    def adopt(self, desired: Desired, last_epochs: Mapping[str, int]) -> None:
        """Go on with what an earlier manager left, in place of what was planned."""
        self._epochs = dict(last_epochs)
        # that of one on a computer that is out of reach is not known, and lower
        statuses = self.agents.statuses().values()
        self._last_epoch = max((s.generation for s in statuses), default=0)
        # a record of its own also when it is just what was planned: agents refuse one
        # that is older than what they were told last
        desired = structs.replace(desired, generation=self._last_epoch)
        self.commit(desired, "taking the robot over")

    def note_lost_state(self, component: str, computer: str, what: str) -> None:
        """Journal that a component lost its state; `status` shows it."""
        self.journal.note("wrong", what)
        self.lost_states[component] = Deviation(
            what=what, computer=computer, component=component, since=wall_time()
        )

    def why_no_checkpoint(self, component: str) -> str:
        """Return why a component that loses its state has no checkpoint, for people."""
        if self.robot.component(component).checkpoint:
            return "this manager has no copy of its checkpoint"
        return "it has no `checkpoint` in the robot file"

    def note_checkpoint(self, computer: str, copy: CheckpointCopy, why: str) -> None:
        """Journal from which state a component goes on, or why it has none."""
        name = copy.component
        if why:
            what = (
                f"component '{name}' starts on '{computer}' without the state that it "
                f"had: its agent did not take the checkpoint ({why})"
            )
            self.note_lost_state(name, computer, what)
        else:
            what = f"component '{name}' goes on from its state of {copy.age:.1f} s ago"
            self.journal.note("done", what)

    def leave(self) -> None:
        """Leave the robot as it is: a stop does nothing from now on."""
        self.is_left = True

    def gateways(self) -> dict[str, str]:
        """Return where each computer's containers are reached, also while it is not."""
        self._gateways |= gateways(self.agents.statuses())
        return self._gateways

    def next_epoch(self, component: str) -> int:
        """Return an epoch that no incarnation of the component has had."""
        last = self._epochs.get(component, self._last_epoch)
        # a leader before may have started some that no record knows
        least = self.agents.manager.term << 16 if self.agents.election else 0
        self._epochs[component] = max(last + 1, least)
        return self._epochs[component]

    def begun(self, component: str, computer: str) -> Incarnation:
        """Return a new incarnation of a component that does not run."""
        other = self.desired.other_code.get(component)
        if other is not None and other.instead_of != self._own_code(component):
            other = None  # the robot has been started with other code since
        return Incarnation(
            component=component,
            computer=computer,
            epoch=self.next_epoch(component),
            implementation=other.implementation if other else "",
            code=other.code if other else "",
        )

    def _other_code(self, desired: Desired) -> dict[str, OtherCode]:
        """Return which components have other code, as far as they were placed."""
        known = dict(desired.other_code)
        for name, placed in desired.placed.items():
            known.pop(name, None)
            if placed.implementation or placed.code:
                instead_of = self._own_code(name)
                known[name] = OtherCode(placed.implementation, placed.code, instead_of)
        return known

    def _ended(self, desired: Desired) -> dict[str, int]:
        """Return the epochs of what has ended, where agents were told of it."""
        ended = {
            name: placed.epoch
            for name, placed in self.desired.placed.items()
            # what was to start on a computer that was not claimed is not there
            if self.desired.generation and placed.computer in self.claimed
        }
        last = {**ended, **desired.ended}
        return {n: epoch for n, epoch in last.items() if n not in desired.placed}

    def _own_code(self, component: str) -> str:
        return f"{self.robot.component(component).implementation}@{self.robot.deployed}"

    def _unleased(self, left: Iterable[Incarnation]) -> Iterator[Incarnation]:
        """Yield what no lease ends, and what may begin on another computer."""
        allowed = allowed_computers(self.robot)
        for each in left:
            is_elsewhere = len(allowed.get(each.component, ())) > 1
            if is_elsewhere and each.component not in self.layout.leased:
                yield each

    def why_held(self, component: str) -> str:
        """Return why a component stays inactive, for people."""
        missing = allowed_computers(self.robot)[component] - self.claimed
        names = " or ".join(f"'{name}'" for name in sorted(missing))
        return (
            f"component '{component}' waits: another manager may run it on {names}, "
            "which this one has not reached. `poise up FILE --take-over` starts it "
            "anyway"
        )

    def _reconcile(self) -> None:
        now = self.desired, dict(self.gateways())
        if now != self._deployed_for:
            desired = self.desired
            if self.agents.election is None:  # what else runs, agents say themselves
                desired = Desired(
                    tasks=desired.tasks,
                    parameters=desired.parameters,
                    other_code=desired.other_code,
                    crashed=desired.crashed,
                    ended=desired.ended,
                    left_behind=tuple(self._unleased(desired.left_behind)),
                )
            encoded, term = encode(desired), self.agents.manager.term
            is_last = self.desired.is_stopped
            self._deployments = {
                computer: structs.replace(
                    deployment, desired=encoded, term=term, is_last=is_last
                )
                for computer, deployment in self.layout.deployments(
                    self.desired, now[1]
                ).items()
            }
            self._deployed_for = now
        for computer, deployment in self._deployments.items():
            wanted = None if computer in self._joining else deployment
            tell = partial(self.reconciler.step, computer, wanted)
            self.parts.run(f"tell the agent of '{computer}' what should run", tell)
        known = [name for name, joining in self._joining.items() if joining.is_known()]
        if known:
            self._join_found({name: self._joining.pop(name) for name in known})

    def _note_claimed(self, computer: str, answer: Claimed) -> None:
        """Take in what an agent works towards that was claimed."""
        deployment = answer.deployment or Deployment(generation=0, containers=())
        lacking = []
        if computer in self.claimed:  # this manager knows their components
            lacking = self._lacking(computer, deployment)
            deployment = structs.replace(deployment, containers=())
        self._joining[computer] = JoiningComputer(
            computer,
            deployment,
            self.agents,
            self.clock,
            self.batch_numbers,
            is_cut_off=answer.is_cut_off,
            lacking=lacking,
        )

    def _lacking(self, computer: str, deployment: Deployment) -> list[CheckpointCopy]:
        """Return checkpoints of what is placed that an agent lost, as by a boot."""
        known = {c.key for c in deployment.components}
        copies = [
            self.agents.checkpoints.get(*placed.key)
            for placed in self.placed.values()
            if placed.computer == computer and placed.key not in known
        ]
        return [copy for copy in copies if copy is not None]

    def _join_found(self, joining: Mapping[str, JoiningComputer]) -> None:
        """Adopt what is at work on computers that were claimed for the first time."""
        for computer, each in joining.items():
            for copy, why in each.checkpoints():
                self.note_checkpoint(computer, copy, why)
        deployments = {name: each.deployment for name, each in joining.items()}
        fenced = {name for name, each in joining.items() if each.is_cut_off}
        committed = frozenset[tuple[str, int]]().union(
            *(each.committed for each in joining.values())
        )
        found = found_in(deployments)
        at_work = as_committed(found, self.agents.statuses(), committed)
        for reported in at_work:
            self._epochs[reported.name] = max(
                self._epochs.get(reported.name, self._last_epoch), reported.spec.epoch
            )
        names = ", ".join(f"'{name}'" for name in sorted(deployments))
        missing = (
            {c.name for c in self.robot.computers} - self.claimed - deployments.keys()
        )
        desired = joined_by(
            self.desired,
            self.robot,
            at_work,
            self.claimed,
            missing,
            fenced,
            self.doubted,
        )
        last = max(deployment.generation for deployment in deployments.values())
        desired = structs.replace(
            desired, generation=max(last, self.desired.generation) + 1
        )
        self.claimed |= deployments.keys()
        self.commit(desired, f"components on {names} keep running")
        going_on = {
            r.name: r for r in at_work if r.incarnation == self.placed.get(r.name)
        }
        for name, why in differences(going_on, self.robot, self.layout, going_on):
            text = f"component '{name}' goes on as it was started: {why}"
            way_out = "a move, `poise replace` or a new start makes it as the file says"
            self.journal.note("wrong", f"{text}; {way_out}")
