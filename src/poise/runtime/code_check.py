"""Checks the code that a robot file names, and its fit to the file.

A child process imports it, for that may end, crash or hang: it names each component
before, so the parent knows which one ended it, and another child checks the others.
"""

from __future__ import annotations

import dis
import inspect
import os
import signal
import subprocess
import sys
import traceback
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import suppress
from tempfile import TemporaryFile
from types import CodeType
from typing import Any

import msgspec

from poise.decoding import from_json, from_msgpack
from poise.errors import PoiseError, RobotError, RunError, UsageError, signal_name
from poise.model.check.connectors import (
    KnownPort,
    check_cycles,
    check_ports,
    check_unconnected,
)
from poise.model.check.names import components
from poise.model.check.task_checks import check_ends, check_generated, check_timers
from poise.model.robot import ComponentEntry, PortKind, Robot
from poise.model.software import CodeTimer, ComponentCode
from poise.model.yaml_tree import Finding, Path
from poise.runtime.code_references import check_origin, check_parameters, check_programs
from poise.runtime.component.component import Component
from poise.runtime.component.implementation import (
    find,
    find_for,
    find_function,
    find_type,
    fingerprint,
    load_module,
    search_also,
)
from poise.runtime.component.ports import is_oneway, methods_of, ports_of, timers_of
from poise.runtime.component.started_calls import ANSWER
from poise.runtime.connectors.interface import methods
from poise.runtime.hosting.command_line import die_with_parent
from poise.runtime.migration.state_check import check_state
from poise.waker import wait_readable
from poise.wire.codec import codec

_Known = dict[str, dict[str, KnownPort]]
_BrokenImport = tuple[Path, str, RobotError]
"""The component in the robot file, its name, and why its module is not imported."""

IMPORT_LIMIT = 60.0
"""How long the code of one component may take to be imported [s]."""
_REAP = 1.0
"""How long a child may take to end after it closed its pipe [s]."""
_CHUNK = 1 << 16
_STDERR = 2
_CHILD = "from poise.runtime.code_check import serve; serve()"


def check_code(
    robot: Robot,
    skipped: AbstractSet[str] = frozenset(),
    begin: Callable[[str], None] = lambda _: None,
) -> list[Finding]:
    """Return every problem between `robot` and its code, which is imported here."""
    search_also(robot.repository)
    findings: list[Finding] = []
    known: _Known = {}
    timers: dict[str, Collection[str]] = {}
    reentrant: set[str] = set()
    broken: dict[object, list[_BrokenImport]] = {}
    for path, architecture, component in components(robot):
        if component.name in skipped:
            continue
        begin(component.name)
        module = component.implementation.partition(":")[0]
        try:
            if module:
                load_module(module, robot.folder)
        except RobotError as error:
            broken.setdefault(_origin(error), []).append((path, component.name, error))
            continue
        ports = _ports(path, component, robot.folder)
        if isinstance(ports, list):
            findings += ports
            continue
        if ports or component.implementation:
            known[component.name] = ports
        if component.implementation:
            code = find(component.implementation, robot.folder)
            timers[component.name] = timers_of(code)
            reentrant |= {component.name} if code.reentrant else set()
            findings += check_origin(path, architecture, module)
            findings += check_parameters(path, component, code)
    begin("")
    findings += map(_import_finding, broken.values())
    findings += check_ports(robot, known)
    findings += check_unconnected(robot, known)
    findings += check_cycles(robot, known, reentrant)
    findings += check_generated(robot, known)
    findings += check_programs(robot)
    findings += _check_functions(robot)
    findings += check_ends(robot, known)
    findings += check_timers(robot, timers)
    return findings


def code_of(entry: ComponentEntry, folder: str) -> ComponentCode:
    """Return what the class of a component declares."""
    code = find_for(entry.implementation, entry.parameters, folder)
    ports, timers = ports_of(code), timers_of(code)
    handlers = {name: [name] for name in timers} | {
        name: methods_of(port.type) if port.kind == "provides" else [port.handler]
        for name, port in ports.items()
        if port.kind in {"subscribes", "provides"}
    }
    out = {n for n, port in ports.items() if port.kind in {"publishes", "requires"}}
    uses = {name: _Uses(code, out, methods) for name, methods in handlers.items()}
    if callbacks := [each for use in uses.values() for each in use.callbacks]:
        callbacks += handlers.get(ANSWER, ())
        uses[ANSWER] = answers = _Uses(code, out, callbacks)
        for each in answers.callbacks:
            answers.add(each)
    return ComponentCode(
        timers=tuple(
            CodeTimer(timer.name, timer.period, timer.deadline)
            for timer in timers.values()
        ),
        keep={
            name: port.queue.size
            for name, port in ports.items()
            if port.queue and port.queue.policy == "keep"
        },
        blocks=tuple(
            name
            for name, port in ports.items()
            if port.queue and port.queue.policy == "block"
        ),
        sends={name: tuple(sorted(use.ports)) for name, use in uses.items()},
        starts={name: use.started() for name, use in uses.items() if use.started()},
        ports={name: port.kind for name, port in ports.items()},
    )


class _Uses:
    """The ports that methods use, and how, and the `callbacks` that take answers."""

    def __init__(
        self,
        code: type[Component],
        out: AbstractSet[str],
        methods: Iterable[str | CodeType],
    ) -> None:
        self._code, self._out = code, out
        self.ports, self.callbacks = set[str](), list[str | CodeType]()
        self._called, self._waits = set[str](), dict[str, bool]()
        self._seen = set[str | CodeType]()
        for method in methods:
            self.add(method)

    def add(self, method: str | CodeType) -> None:
        """Add what a method or function uses, and those that it defines or calls."""
        if method in self._seen:
            return
        self._seen.add(method)
        if isinstance(method, str):
            found = inspect.unwrap(getattr(self._code, method, None) or _nothing)
            if inspect.isfunction(found):
                self.add(found.__code__)
            return
        names = [
            each.argval
            for each in dis.get_instructions(method)
            if each.opcode in dis.hasname or inspect.iscode(each.argval)
        ]
        waits = "result" in names and "done" not in names
        before = ""
        for name in names:
            if name in {"start_call", "then"}:
                before = name
            elif name in self._out:
                self.ports.add(name)
                if before == "start_call":
                    self._waits[name] = self._waits.get(name, False) or waits
                else:
                    self._called.add(name)
                before = ""
            elif inspect.iscode(name) or callable(getattr(self._code, name, None)):
                if before == "then":
                    self.callbacks.append(name)
                else:
                    self.add(name)
                before = ""

    def started(self) -> dict[str, bool]:
        """Return the ports of which they only start calls -> whether they wait."""
        return {n: w for n, w in self._waits.items() if n not in self._called}


def _nothing() -> None:
    """Use no name."""


def _check_functions(robot: Robot) -> Iterator[Finding]:
    """Yield the policies whose own function cannot be called."""
    for policy in robot.policies:
        if policy.call is None or policy.off:
            continue
        text = ""
        try:
            function = find_function(policy.call, robot.folder)
            inspect.signature(function).bind("seen")
        except RobotError as error:
            text = str(error)
        except TypeError:
            name = policy.call.partition(":")[2]
            text = f"'{policy.call}' has to take one argument, as in `def {name}(seen)`"
        except ValueError:  # it has no signature
            pass
        if text:
            path = ("policies", policy.name, "call")
            yield Finding(path, f"policy '{policy.name}': {text}")


def _origin(error: RobotError) -> object:
    """Return the line that made an import fail: the same for all who import it."""
    cause = error.__cause__
    if cause is None:
        return str(error)
    (*_, (frame, line)) = traceback.walk_tb(cause.__traceback__)
    return type(cause), str(cause), frame.f_code.co_filename, line


def _import_finding(same: Sequence[_BrokenImport]) -> Finding:
    """Return one finding for all components whose imports fail at one line."""
    path, name, error = same[0]
    others = ", ".join(f"'{other}'" for _, other, _ in same[1:])
    of = f" (component '{name}', and for the same reason {others})" if others else ""
    what, newline, lines = str(error).partition("\n")
    return Finding((*path, "implementation"), f"{what}{of}{newline}{lines}")


def _ports(
    path: Path, component: ComponentEntry, folder: str
) -> dict[str, KnownPort] | list[Finding]:
    """Return the ports that class and robot file declare, or what is wrong."""
    ports, where = dict[str, KnownPort](), (*path, "implementation")
    try:
        if component.implementation:
            ports = _coded_ports(component, folder)
        for port in component.ports:
            where = (*path, "ports", port.name, port.kind)
            declared = find_type(port.type, folder)
            ports[port.name] = _known(port.name, port.kind, declared)
    except UsageError as error:
        return [Finding(where, line) for line in str(error).splitlines()]
    except PoiseError as error:
        return [Finding(where, str(error))]
    # Reading annotations runs the user's code, which may raise anything.
    except Exception as error:  # noqa: BLE001
        said = f"{type(error).__name__}: {error}"
        of = component.implementation or component.name
        return [Finding(where, f"the ports of '{of}' cannot be read: {said}")]
    return ports


def _coded_ports(component: ComponentEntry, folder: str) -> dict[str, KnownPort]:
    """Return the ports of a class; PoiseError: it cannot be run."""
    code = find_for(component.implementation, component.parameters, folder)
    ports = ports_of(code)
    timers_of(code)
    known = {
        name: _known(
            name,
            port.kind,
            port.type,
            blocks=port.queue is not None and port.queue.policy == "block",
        )
        for name, port in ports.items()
    }
    for port in ports.values():
        # raises when the type cannot be encoded
        (methods if port.kind in {"provides", "requires"} else codec)(port.type)
    check_state(code)
    _check_keeps_state(component, code)
    return known


def _check_keeps_state(entry: ComponentEntry, code: type[Component]) -> None:
    """Raise when a component with checkpoints cannot give or take its state."""
    gives = code.snapshot is not Component.snapshot
    takes = code.restore is not Component.restore
    keeps_messages = any(port.latest for port in ports_of(code).values())
    has_state = (gives and takes) or (keeps_messages and not gives and not takes)
    if entry.checkpoint and not has_state:
        raise RobotError(
            f"'{entry.implementation}' has no `snapshot` or no `restore`: write them, "
            "or leave out `checkpoint`"
        )


def _known(
    name: str,
    kind: PortKind,
    type_: Any,  # noqa: ANN401, any type
    *,
    blocks: bool = False,
) -> KnownPort:
    shown = getattr(type_, "__qualname__", str(type_))
    waits = kind == "requires" and not all(
        is_oneway(type_, method) for method in methods_of(type_)
    )
    return KnownPort(name, kind, shown, fingerprint(type_), waits or blocks)


class CheckedCode(msgspec.Struct, frozen=True):
    """What is wrong with a robot's code; when nothing is, what it declares."""

    findings: list[Finding]
    code: Mapping[str, ComponentCode] = {}


class _Death(msgspec.Struct, frozen=True):
    """A child that gave no findings: its last component, and how it ended."""

    component: str
    how: str


def check_code_isolated(
    robot: Robot,
    limit: float = IMPORT_LIMIT,
    meanwhile: Callable[[], object] = lambda: None,
) -> CheckedCode:
    """Return `check_code`'s findings, and code that ends, crashes or hangs."""
    if _CHILD in sys.orig_argv:
        raise UsageError(
            "a robot is loaded while its code is imported: guard scripts with `if "
            "__name__ == '__main__':`"
        )
    fatal: dict[str, Finding] = {}
    while isinstance(result := _check(robot, fatal, limit, meanwhile), _Death):
        blamed = _blamed(robot, result)
        if not blamed:
            raise RunError(f"the check of the code of '{robot.name}' {result.how}")
        fatal |= blamed
    findings = [*dict.fromkeys(fatal.values()), *result.findings]
    return CheckedCode(findings, result.code)


def serve() -> None:
    """Be the child whose arguments are ``PIPE SKIPPED...``; never returns."""
    pipe, *skipped = sys.argv[1:]
    os.set_inheritable(int(pipe), False)
    robot = from_msgpack(sys.stdin.buffer.read(), Robot)
    with os.fdopen(int(pipe), "wb", buffering=0) as answers:

        def answer(item: str | CheckedCode) -> None:
            answers.write(msgspec.json.encode(item) + b"\n")

        findings = check_code(robot, frozenset(skipped), answer)
        is_right = not (findings or skipped)
        parts = [c for c in robot.components() if is_right and c.implementation]
        code = {part.name: code_of(part, robot.folder) for part in parts}
        sys.stdout.flush()  # with the answer this process is ended
        answer(CheckedCode(findings, code))
    os._exit(0)  # the robot's code may have left threads that never end


def _check(
    robot: Robot, skipped: Iterable[str], limit: float, meanwhile: Callable[[], object]
) -> CheckedCode | _Death:
    reader, writer = os.pipe()
    with (
        TemporaryFile() as file,
        os.fdopen(reader, "rb", buffering=0),
        os.fdopen(writer, "wb") as inherited,
    ):
        file.write(msgspec.msgpack.encode(robot))
        file.seek(0)
        child = subprocess.Popen(  # noqa: S603 - our own code, in our own Python
            [sys.executable, "-P", "-c", _CHILD, str(writer), *skipped],
            stdin=file,
            stdout=_STDERR,
            pass_fds=(writer,),
            start_new_session=True,
            # safe beside other threads: it takes no lock that one of them may hold
            preexec_fn=die_with_parent,  # noqa: PLW1509
        )
        inherited.close()
        try:
            meanwhile()
            return _result(child, reader, limit)
        finally:
            # The session holds what the code started, too.
            with suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGKILL)
            child.wait()


def _result(
    child: subprocess.Popen[bytes], reader: int, limit: float
) -> CheckedCode | _Death:
    component, text = "", b""
    while wait_readable([reader], limit):
        chunk = os.read(reader, _CHUNK)
        if not chunk:
            break
        *lines, text = (text + chunk).split(b"\n")
        for line in lines:
            if line.startswith(b"{"):
                return from_json(line, CheckedCode)
            component = from_json(line, str)
    return _Death(component, _ending(child, limit))


def _ending(child: subprocess.Popen[bytes], limit: float) -> str:
    try:
        code = child.wait(_REAP)
    except subprocess.TimeoutExpired:
        return f"did not end within {limit:g} s"
    if code < 0:
        return f"crashed by signal {-code} ({signal_name(-code)})"
    return f"ended the process with exit code {code}"


def _blamed(robot: Robot, death: _Death) -> dict[str, Finding]:
    """Return the finding for each component whose code is in the module that died."""
    for path, _, component in components(robot):
        if component.name == death.component:
            module = component.implementation.partition(":")[0]
            what = (
                f"the import of module '{module}'" if module else "the import of types"
            )
            finding = Finding(
                (*path, "implementation"),
                f"component '{component.name}': {what} {death.how}. Importing a module "
                "must only define things: guard scripts with `if __name__ == "
                "'__main__':`, and do slow work in the component's `configure`",
            )
            return {
                other.name: finding
                for other in robot.components()
                if other is component
                or (module and other.implementation.partition(":")[0] == module)
            }
    return {}
