"""From a placement to the deployment of each computer. Pure."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from itertools import pairwise
from pathlib import PurePath
from typing import Any

from msgspec import Struct, structs

from poise.manage.deploy.desired import Desired, Incarnation
from poise.model.check.allowed_computers import leased_components
from poise.model.robot import (
    Action,
    Architecture,
    ComponentEntry,
    Connector,
    ConnectorEnd,
    Robot,
)
from poise.model.software import importance
from poise.model.steps import actions_of, walk
from poise.wire.records.deployment_records import (
    ChainPart,
    ComponentSpec,
    ConnectorKind,
    ConnectorSpec,
    ContainerSpec,
    Deployment,
)

_DIGITS = 8
"""Digits of the version of its code in a container's name."""
FILLS_INTERPRETER = 0.5
"""A component with a larger CPU demand [cores] gets a container of its own: threads of
one Python process share one core."""

_STRANGERS = {"stay", "inactive"}
"""The source and the target of a migration are not connected with each other."""

_NOT_KNOWN = "0.0.0.0:1"
"""The gateway of a computer that was never reached: nobody is there."""


class DeploymentLayout:
    """Which containers and connectors a robot's components have."""

    def __init__(
        self,
        robot: Robot,
        folder: str,
        *,
        weigh: bool = False,
        code_version: Callable[..., str] = lambda *_: "",
    ) -> None:
        self._robot = robot
        self._code_version = code_version
        self._code: dict[tuple[str, str], str] = {}
        self._weigh = weigh
        self._folder = folder
        self._architecture_of = {
            c.name: a for a in robot.architectures for c in a.components
        }
        self._containers = {
            c.name: _container(a, c) for a in robot.architectures for c in a.components
        }
        self._weights = cpu_weights(robot)
        self._components = {c.name: c for c in robot.components()}
        self.computers = {c.name: c for c in robot.computers}
        self.leased = leased_components(robot)
        # command-line components speak by their own means: nothing is joined to them
        commands = {c.name for c in robot.components() if c.command}
        self._joinable = [
            connector
            for connector in robot.all_connectors()
            if not connector.topic
            and commands.isdisjoint(end.component for end in connector.between)
        ]

        self._ends = _ends(robot)
        self._slots = _slots(robot, self._architecture_of)
        self._parts = _chain_parts(robot)
        self._carries = _chains_over(robot, self._slots)
        self._answers = _chains_over(robot, self._slots, answers=True)

    def container_of(self, incarnation: Incarnation) -> str:
        """Return its container's name; other code has its own: Python imports once."""
        container = self._containers[incarnation.component]
        if incarnation.code:  # no name has a dot in it, so no other container has this
            container = f"{container}..{incarnation.code[:_DIGITS]}"
        return container

    def address(
        self, target: Incarnation, computer: str, gateways: Mapping[str, str]
    ) -> str:
        """Return where a component's container is reached from a computer."""
        container = self.container_of(target)
        if target.computer == computer:
            return container
        return f"{gateways.get(target.computer, _NOT_KNOWN)}/{container}"

    def deployments(
        self, desired: Desired, gateways: Mapping[str, str]
    ) -> dict[str, Deployment]:
        """Return what should run on each computer, by its name."""
        placed = desired.incarnations()
        connectors = self._connectors(placed, gateways)
        containers: dict[str, list[ContainerSpec]] = {
            computer.name: [] for computer in self._robot.computers
        }
        groups: dict[tuple[str, str], list[Incarnation]] = {}
        for incarnation in placed:
            groups.setdefault(self.container_at(incarnation), []).append(incarnation)
        for at, inside in groups.items():
            computer, container = at
            code = inside[0].code or self._robot.deployed
            weight = self._weights[self._architecture_of[inside[0].component].name]
            containers[computer].append(
                ContainerSpec(
                    name=container,
                    folder="" if code else self._robot.folder,
                    weight=weight.weight,
                    nice=weight.nice,
                    preparation_cpu=desired.preparation_cpu.get(computer, 0.0)
                    if all(each.unjoined and each.gently for each in inside)
                    else 0.0,
                    repository=() if code else self._robot.repository,
                    code=code,
                    components=tuple(
                        self.component_spec(
                            each, desired.parameters.get(each.component, {})
                        )
                        for each in inside
                    ),
                    connectors=tuple(connectors.get(at, ())),
                )
            )
        codes = {self._robot.deployed, *(incarnation.code for incarnation in placed)}
        kept = tuple(sorted(codes - {""}))
        return {
            computer: Deployment(
                generation=desired.generation, containers=tuple(specs), code=kept
            )
            for computer, specs in containers.items()
        }

    def connectors(self, placed: Iterable[str]) -> list[Connector]:
        """Return the connectors between placed components that Poise joins."""
        there = set(placed)
        return [
            connector
            for connector in self._joinable
            if all(end.component in there for end in connector.between)
        ]

    def connectors_at(
        self, components: Collection[str], placed: Iterable[str]
    ) -> list[Connector]:
        """Return those of `connectors` that begin or end at some components."""
        return [
            connector
            for connector in self.connectors(placed)
            if any(end.component in components for end in connector.between)
        ]

    def limits_from(self, component: str) -> dict[str, float]:
        """Return connector -> time limit of its calls [s], where it begins there."""
        return {
            str(connector): connector.limit
            for connector in self._joinable
            if connector.between[0].component == component
        }

    def slot_of(self, connector: Connector) -> str:
        """Return what the source calls its end: alike for an alternative's connector.

        The nth connector from a port to an architecture has the slot of the nth from
        there to its alternatives.
        """
        return self._slots[str(connector)]

    def key_of(self, connector: Connector, placed: Mapping[str, Incarnation]) -> str:
        """Return what both ends call a connector between placed components."""
        source, target = (placed[end.component] for end in connector.between)
        return self.joined(connector, source, target, {}).key

    def joined(
        self,
        connector: Connector,
        source: Incarnation,
        target: Incarnation,
        gateways: Mapping[str, str],
    ) -> ConnectorSpec:
        """Return a connector between two incarnations."""
        kind: ConnectorKind = "direct"
        address = ""
        if source.computer != target.computer:
            kind = "remote"
        elif self.container_of(source) != self.container_of(target):
            kind = "local"
        if kind != "direct":
            address = self.address(target, source.computer, gateways)
        first, second = connector.between
        slot = self.slot_of(connector)
        return ConnectorSpec(
            name=str(connector),
            slot=slot,
            kind=kind,
            source=source.component,
            source_epoch=source.epoch,
            source_port=first.port,
            source_computer=source.computer,
            target=target.component,
            target_epoch=target.epoch,
            target_port=second.port,
            target_computer=target.computer,
            address=address,
            limit=connector.limit,
            record=connector.record,
            # what is recorded is replayed without stamps
            carries=() if connector.record else self._carries.get(slot, ()),
            answers=() if connector.record else self._answers.get(slot, ()),
        )

    def container_at(self, incarnation: Incarnation) -> tuple[str, str]:
        """Return its computer and its container."""
        return incarnation.computer, self.container_of(incarnation)

    def component_spec(
        self, incarnation: Incarnation, parameters: Mapping[str, Any] = {}
    ) -> ComponentSpec:
        """Return what its agent is told; `parameters`: those set since the start."""
        component = self._components[incarnation.component]
        implementation = incarnation.implementation or component.implementation
        is_other = implementation != component.implementation
        return ComponentSpec(
            name=component.name,
            epoch=incarnation.epoch,
            goal=incarnation.goal,
            implementation=implementation,
            instead_of=component.implementation if is_other else "",
            code=self._code_of(component, implementation),
            command=component.command,
            environment=component.environment,
            adapt=incarnation.adapt,
            fresh=incarnation.fresh,
            parameters=component.parameters,
            changed_parameters=parameters,
            devices={
                name: path and str(PurePath(self._folder) / path)
                for name in component.devices
                for path in [self._robot.device(name).path]
            },
            weigh=self._weigh,
            checkpoint=component.checkpoint,
            restart_when_hung=component.restart_when_hung,
            gently=incarnation.gently,
            follows=incarnation.follows,
            chains=self._parts.get(component.name, ()),
            leased=component.name in self.leased,
            held=incarnation.held,
            ends=self._ends.get(component.name, ()),
            actions=incarnation.actions,
        )

    def _code_of(self, component: ComponentEntry, implementation: str) -> str:
        """Return the version of its code when this manager first read that.

        A container imports each module once: what is edited later may not run.
        """
        key = component.name, implementation
        if key not in self._code:
            self._code[key] = self._present_code(component, implementation)
        return self._code[key]

    def _present_code(self, component: ComponentEntry, implementation: str) -> str:
        # parameters are compared by themselves
        code = structs.replace(component, implementation=implementation, parameters={})
        return self._robot.deployed or self._code_version(code, *self._robot.folders)

    def is_edited(self, incarnation: Incarnation) -> bool:
        """Return whether its code is no longer what it was when it was first read."""
        component = self._components[incarnation.component]
        implementation = incarnation.implementation or component.implementation
        present = self._present_code(component, implementation)
        return present != self._code_of(component, implementation)

    def _connectors(
        self, placed: tuple[Incarnation, ...], gateways: Mapping[str, str]
    ) -> dict[tuple[str, str], list[ConnectorSpec]]:
        """Return the connectors with an end in each container."""
        found: dict[tuple[str, str], list[ConnectorSpec]] = {}
        by_name: dict[str, list[Incarnation]] = {}
        for incarnation in placed:
            if not incarnation.unjoined:
                by_name.setdefault(incarnation.component, []).append(incarnation)
        for connector in self._joinable:
            first, second = connector.between
            for source in by_name.get(first.component, ()):
                for target in by_name.get(second.component, ()):
                    if {source.goal, target.goal} == _STRANGERS:
                        continue
                    if target.parting and not source.parting:
                        continue
                    spec = self.joined(connector, source, target, gateways)
                    for home in {
                        self.container_at(source): 1,
                        self.container_at(target): 1,
                    }:
                        found.setdefault(home, []).append(spec)
        return found


def _ends(robot: Robot) -> dict[str, tuple[str, ...]]:
    """Return the ports of each component that end actions."""
    ends: dict[str, tuple[str, ...]] = {}
    for task in robot.tasks:
        for _, step in walk(task):
            if isinstance(step, Action) and step.ends is not None:
                name, port = step.ends.component, step.ends.port
                ends[name] = tuple(dict.fromkeys([*ends.get(name, ()), port]))
    return ends


def _chain_parts(robot: Robot) -> dict[str, tuple[ChainPart, ...]]:
    """Return the chains that each component is part of."""
    parts: dict[str, tuple[ChainPart, ...]] = {}
    for chain in robot.chains:
        first, last = chain.through[0], chain.through[-1]
        for name in chain.through:
            part = ChainPart(
                name=chain.name,
                is_first=name == first,
                deadline=chain.deadline if name == last else None,
            )
            parts[name] = (*parts.get(name, ()), part)
    return parts


def _chains_over(
    robot: Robot, slots: Mapping[str, str], *, answers: bool = False
) -> dict[str, tuple[str, ...]]:
    """Return the chains over each slot, from source to target, or with answers."""
    over: dict[str, dict[str, None]] = {}
    for connector in robot.all_connectors():
        source, target = (end.component for end in connector.between)
        hop = (target, source) if answers else (source, target)
        for chain in robot.chains:
            if hop in pairwise(chain.through):
                over.setdefault(slots[str(connector)], {})[chain.name] = None
    return {slot: tuple(names) for slot, names in over.items()}


def _slots(robot: Robot, homes: Mapping[str, Architecture]) -> dict[str, str]:
    """Return the slots of all connectors, by name."""
    counts: Counter[tuple[ConnectorEnd, str]] = Counter()
    first: dict[tuple[ConnectorEnd, str, int], str] = {}
    slots = {}
    for connector in robot.all_connectors():
        source, target = connector.between
        there = homes[target.component]
        rank = counts[source, there.name]
        counts[source, there.name] += 1
        name = str(connector)
        slots[name] = first.setdefault((source, there.function, rank), name)
    return slots


def _container(architecture: Architecture, component: ComponentEntry) -> str:
    alone = component.isolated or component.command
    if alone or component.demand.get("cpu", 0.0) > FILLS_INTERPRETER:
        # no name has a dot in it, so no two containers have the same name
        return f"{architecture.name}.{component.name}"
    return architecture.name


USUAL = 100
"""The weight of the lowest priority: that of any other program."""
_LESS_A_STEP = 1.25
"""A thread that is nicer by 1 gets about this times less CPU."""
_NICEST = 19


class CpuWeight(Struct, frozen=True):
    """The share of the CPU of a container, when that is not enough for all."""

    weight: int = 0  # as cgroups have it, in [1, 10000]; 0: all containers are alike
    # of its threads, where there are no cgroups; 0 for the highest priority
    nice: int = 0


def cpu_weights(robot: Robot) -> Mapping[str, CpuWeight]:
    """Return architecture -> CPU weight; only the order of priorities counts.

    What is prepared for a later action has none: where there may be such, all have one.
    """
    counts = importance(a.priority for a in robot.architectures)
    if len(counts) < 2:  # noqa: PLR2004 - nothing is above anything
        alike = CpuWeight(USUAL if _may_prepare(robot) else 0)
        return {a.name: alike for a in robot.architectures}
    most = max(counts.values())
    weights = {
        priority: CpuWeight(
            round(USUAL * times),
            min(round(math.log(most / times) / math.log(_LESS_A_STEP)), _NICEST),
        )
        for priority, times in counts.items()
    }
    return {a.name: weights[a.priority] for a in robot.architectures}


def _may_prepare(robot: Robot) -> bool:
    tasks = {task.name: task for task in robot.tasks}
    actions = [action for name in tasks for action in actions_of(tasks, name)]
    return not robot.prefetch.off and len(actions) > 1
