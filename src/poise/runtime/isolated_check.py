"""Checks a robot's code in a child process: importing it may end, crash or hang.

The child names each component before it imports its code, so the parent knows which one
ended it, and another child checks the others.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from tempfile import TemporaryFile

import msgspec

from poise.errors import RunError
from poise.model.check.names import components
from poise.model.robot import ComponentEntry, Robot
from poise.model.software import ComponentCode
from poise.model.yaml.tree import Finding
from poise.runtime.hosting.command_line import die_with_parent

CodeOf = Callable[[ComponentEntry, str], ComponentCode]
IMPORT_LIMIT = 60.0
"""How long the code of one component may take to be imported [s]."""
_REAP = 1.0
"""How long a child may take to end after it closed its pipe [s]."""
_CHUNK = 1 << 16
_STDERR = 2
_CHILD = """
from poise.runtime.code_check import check_code, code_of
from poise.runtime.isolated_check import serve
serve(check_code, code_of)
"""


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
    fatal: dict[str, Finding] = {}
    while isinstance(result := _check(robot, fatal, limit, meanwhile), _Death):
        blamed = _blamed(robot, result)
        if not blamed:
            raise RunError(f"the check of the code of '{robot.name}' {result.how}")
        fatal |= blamed
    findings = [*dict.fromkeys(fatal.values()), *result.findings]
    return CheckedCode(findings, result.code)


def serve(check: Callable[..., list[Finding]], code_of: CodeOf) -> None:
    """Be the child whose arguments are ``PIPE SKIPPED...``; never returns."""
    pipe, *skipped = sys.argv[1:]
    os.set_inheritable(int(pipe), False)
    robot = msgspec.msgpack.decode(sys.stdin.buffer.read(), type=Robot)
    with os.fdopen(int(pipe), "wb", buffering=0) as answers:

        def answer(item: str | CheckedCode) -> None:
            answers.write(msgspec.json.encode(item) + b"\n")

        found = check(robot, frozenset(skipped), answer)
        is_right = not (found or skipped)
        parts = [c for c in robot.components() if is_right and c.implementation]
        code = {each.name: code_of(each, robot.folder) for each in parts}
        sys.stdout.flush()  # with the answer this process is ended
        answer(CheckedCode(found, code))
    os._exit(0)  # the robot's code may have left threads that never end


def _check(
    robot: Robot,
    skipped: Iterable[str],
    limit: float,
    meanwhile: Callable[[], object],
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
    while select.select([reader], [], [], limit)[0]:
        chunk = os.read(reader, _CHUNK)
        if not chunk:
            break
        *lines, text = (text + chunk).split(b"\n")
        for line in lines:
            if line.startswith(b"{"):
                return msgspec.json.decode(line, type=CheckedCode)
            component = msgspec.json.decode(line, type=str)
    return _Death(component, _ending(child, limit))


def _ending(child: subprocess.Popen[bytes], limit: float) -> str:
    try:
        code = child.wait(_REAP)
    except subprocess.TimeoutExpired:
        return f"did not end within {limit:g} s"
    if code < 0:
        return f"crashed by signal {-code} ({signal.Signals(-code).name})"
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
