"""What runs on each computer: `poise agent`, its service, `standby` and `witness`."""

from __future__ import annotations

import contextlib
import logging
import os
import sys
import time
from collections.abc import Iterator, Sequence
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated

import typer

from poise.cli.main import Interrupts
from poise.cli.options import parse_option
from poise.endpoint import AGENT_PORT, Endpoint
from poise.errors import PoiseError, UsageError
from poise.runtime.agent.agent import Agent
from poise.runtime.agent.surroundings import BROKEN, DEPLOYED, AgentSetup
from poise.runtime.container.account import Account
from poise.session.agent_service import AgentService
from poise.session.arguments import check_name
from poise.session.folders import agent_folder, state_folder, system_agent_folder
from poise.threads import explained
from poise.units import SECONDS
from poise.wire.control_session import SESSION_TIMEOUT
from poise.wire.credentials import find, folders, raise_if_of_other_role

log = logging.getLogger(__name__)

_LAST = 65535
_BEFORE_NEXT = 5.0
"""A service that ends sooner than this is not started again before [s]: each start
takes half a second of a core."""


def _name(of: typer.CallbackParam, text: str) -> str:
    """Return a name that a robot file may have; files and units are called so."""
    check_name(text, f"a {of.name}'s name")
    return text


ComputerName = Annotated[
    str, typer.Argument(help="This computer's name.", callback=_name)
]
RobotName = Annotated[str, typer.Option(help="The robot's name.", callback=_name)]
AddressOption = Annotated[
    str, typer.Option(help="IP address by which the others reach this computer.")
]
_Port = Annotated[
    int, typer.Option(min=1, max=_LAST, help="TCP port, and UDP port for heartbeats.")
]
_Folder = Annotated[
    Path | None, typer.Option(help="Its private folder, for sockets and files to keep.")
]
_Keys = Annotated[
    Path | None,
    typer.Option(help="Folder of this computer's keys (`poise keys issue`)."),
]
_Insecure = Annotated[
    bool,
    typer.Option(
        "--insecure", help="Without keys: any host that reaches it commands it."
    ),
]
_Gateway = Annotated[
    int,
    typer.Option(
        min=0, max=_LAST, help="TCP port for connectors from other computers; 0: any."
    ),
]
_Allow = Annotated[
    list[Path] | None,
    typer.Option(
        help="Run only code and programs in this folder, or `deployed` ones; again "
        "for more. Default: deployed ones; on loopback any, as by `/`."
    ),
]
_RunAs = Annotated[
    str, typer.Option(help="For root: the user that the containers run as.")
]
_Lifeline = Annotated[
    int | None, typer.Option(hidden=True, help="End at this descriptor's end.")
]
_SessionTimeout = Annotated[
    float,
    typer.Option(hidden=True, help="A peer that is silent for so long [s] is lost."),
]


def agent_command(
    computer: ComputerName,
    robot: RobotName,
    address: AddressOption,
    port: _Port = AGENT_PORT,
    gateway: _Gateway = 0,
    folder: _Folder = None,
    sample_every: Annotated[
        str, typer.Option(help="How often to sample the CPU use; 0: never.")
    ] = "200 ms",
    keys: _Keys = None,
    insecure: _Insecure = False,
    allow: _Allow = None,
    run_as: _RunAs = "",
    plain_connectors: Annotated[bool, typer.Option(hidden=True)] = False,
    lifeline: _Lifeline = None,
    session_timeout: _SessionTimeout = SESSION_TIMEOUT,
) -> None:
    """Run the containers of this computer until Ctrl-C.

    When it is killed, they go on for a minute, and are adopted when it is started again
    with the same robot, address and port, or the same folder.

    Example: poise agent main --robot t-rot --address 10.0.0.1
    """
    with _not_at_once_again():
        account = Account.of(run_as) if run_as else None
        if account is not None and folder is None:
            folder = system_agent_folder(robot, computer)
        place = folder or agent_folder(f"{robot} {computer} {Endpoint(address, port)}")
        code = folder or state_folder() / robot / f"agent-{computer}"
        _serve(
            AgentSetup(
                robot=robot,
                computer=computer,
                address=address,
                port=port,
                gateway=gateway,
                code=str((code / "code").resolve()),
                folder=str(place),
                lifeline=lifeline,
                session_timeout=session_timeout,
                sample_every=parse_option("--sample-every", sample_every, SECONDS),
                keys=keys_for(robot, computer, address, keys, is_insecure=insecure),
                encrypts=not plain_connectors,
                allow=allowed(address, allow),
                account=account,
            )
        )


def witness_command(
    computer: ComputerName,
    robot: RobotName,
    address: AddressOption,
    port: _Port = AGENT_PORT,
    folder: _Folder = None,
    keys: _Keys = None,
    insecure: _Insecure = False,
    lifeline: _Lifeline = None,
    session_timeout: _SessionTimeout = SESSION_TIMEOUT,
) -> None:
    """Vote for a robot's manager from this computer, until Ctrl-C.

    It is an agent that runs nothing, for a computer with `witness: true` in the robot
    file: of two computers, the one that it reaches goes on without the other.

    Example: poise witness router --robot t-rot --address 10.0.0.9
    """
    place = folder or agent_folder(f"{robot} {computer} {Endpoint(address, port)}")
    _serve(
        AgentSetup(
            robot=robot,
            computer=computer,
            address=address,
            port=port,
            folder=str(place),
            lifeline=lifeline,
            session_timeout=session_timeout,
            sample_every=0.0,
            keys=keys_for(robot, computer, address, keys, is_insecure=insecure),
            is_witness=True,
        )
    )


@contextlib.contextmanager
def _not_at_once_again() -> Iterator[None]:
    """As a service of systemd, wait before a start that fails is repeated."""
    is_service = "NOTIFY_SOCKET" in os.environ  # the agent takes it out
    since = time.monotonic()
    try:
        yield
    except Exception:  # whatever it is, systemd starts it again at once
        if is_service:
            time.sleep(max(0.0, since + _BEFORE_NEXT - time.monotonic()))
        raise


def _serve(setup: AgentSetup) -> None:
    logging.basicConfig(
        format=f"%(asctime)s {setup.computer} %(levelname)s %(name)s: %(message)s",
        level="WARNING",
    )
    logging.getLogger("poise.component").setLevel("INFO")
    is_owned = setup.lifeline is not None
    if is_owned:  # its manager shows the faults already
        logging.getLogger("poise.runtime.supervision.supervisor").setLevel("ERROR")
    with Interrupts() as interrupts:
        agent = Agent(setup, say=(lambda _: None) if is_owned else _say)
        interrupts.check()
        try:
            agent.run()  # with handlers of its own
        except PoiseError:
            raise
        except Exception as error:  # its log is all that the user has
            why = explained(error)
            is_bug = why is error
            log.exception(
                "agent '%s' ended because of %s; its containers keep "
                "running for a minute and wait for the next agent: start it again",
                setup.computer,
                "a bug in Poise" if is_bug else f"a limit: {why}",
                exc_info=is_bug,
            )
            raise typer.Exit(BROKEN) from None


def keys_for(
    robot: str, computer: str, address: str, keys: Path | None, *, is_insecure: bool
) -> str:
    """Return the folder of the agent's keys; empty: it goes without."""
    check_ip(address)
    if is_insecure:
        if keys is not None:
            raise UsageError("--keys and --insecure: give one of the two")
        return ""
    own = find(robot, "agent", folder=keys)
    if own is not None:
        if own.name != f"agent {computer}":
            raise UsageError(
                f"the keys in {own.folder} are of {own.name}, not of agent {computer}: "
                f"`poise keys issue {robot} {computer}` makes those"
            )
        return str(own.folder.resolve())
    if ip_address(address).is_loopback:
        return ""
    raise_if_of_other_role(robot, "agent")
    raise UsageError(
        f"there are no keys for robot '{robot}' (looked in "
        f"{', '.join(map(str, folders(robot)))}): make them by `poise keys issue`, or "
        "write --insecure: then all who reach the port may run code here"
    )


def allowed(address: str, places: Sequence[Path] | None) -> tuple[str, ...]:
    """Return the code that an agent runs, as in `AgentSetup`."""
    if not places:
        return () if ip_address(address).is_loopback else (DEPLOYED,)
    if Path("/") in places:
        return ()
    return tuple(
        DEPLOYED if str(place) == DEPLOYED else str(place.resolve()) for place in places
    )


def _say(sentence: str) -> None:
    with contextlib.suppress(OSError):  # nobody reads it
        sys.stdout.write(f"{time.strftime('%H:%M:%S')} {sentence}\n")
        sys.stdout.flush()


def check_ip(address: str) -> None:
    """Raise UsageError unless it is an IP address without a port."""
    try:
        endpoint = Endpoint.parse(address)
    except ValueError as error:
        raise UsageError(f"--address: {error}") from None
    if not endpoint.is_ip or endpoint.host != address:
        raise UsageError(
            f"--address {address}: give an IP address of this computer, without "
            "brackets or port, as in 10.0.0.1 or fd00::1; --port gives the port"
        )
    if ip_address(address).is_unspecified:
        raise UsageError(
            f"--address {address}: no other computer reaches this one by it; give the "
            "address that the robot file has, as in 10.0.0.1 or fd00::1"
        )


def standby_command(
    computer: ComputerName,
    claim: Annotated[Path, typer.Option(help="The file of the agent's last claim.")],
) -> None:
    """Wait to lead a robot when its manager is gone.

    Agents start it on computers that `manager` of the robot file names, and by default
    on all where there are three. A line `lead` on its standard input lets it lead.

    Example: poise standby main --claim /tmp/poise-agent-0-1f2e/claim
    """
    # the manager, which no agent needs
    from poise.session.up import stand_by

    def say(sentence: str) -> None:
        with contextlib.suppress(OSError):  # nobody reads it
            at = time.strftime("%H:%M:%S")
            sys.stderr.write(f"{at} standby on '{computer}': {sentence}\n")

    stand_by(claim, sys.stdin, say)


_IS_NOT_ROOT = os.getuid() != 0
_OwnUser = Annotated[
    bool,
    typer.Option(
        "--user/--system", help="This user's systemd, or (for root) the machine's."
    ),
]
_UnitFolder = Annotated[
    Path | None,
    typer.Option(help="Write the unit into this folder, and start nothing."),
]


def install_command(
    computer: ComputerName,
    robot: RobotName,
    address: AddressOption,
    port: _Port = AGENT_PORT,
    gateway: _Gateway = 0,
    keys: _Keys = None,
    insecure: _Insecure = False,
    allow: _Allow = None,
    user: _OwnUser = _IS_NOT_ROOT,
    run_as: _RunAs = "",
    unit_folder: _UnitFolder = None,
) -> None:
    """Write a unit of systemd that runs the agent, and start it, now and at each boot.

    systemd restarts the agent when it dies or hangs; its containers go on meanwhile.

    Example: poise agent install left --robot hello --address 10.0.0.1 --run-as robot
    """
    found = keys_for(robot, computer, address, keys, is_insecure=insecure)
    arguments = ["--robot", robot, "--address", address, "--port", str(port)]
    if gateway:
        arguments += ["--gateway", str(gateway)]
    arguments += ["--keys", found] if found else []
    if insecure:
        arguments.append("--insecure")
    for place in (allowed(address, allow) or ("/",)) if allow else ():
        arguments += ["--allow", place]
    service = AgentService(robot, computer, is_users=user, folder=unit_folder)
    user_name = Account.of(run_as).name if run_as else ""
    is_started = service.install(service.text(arguments, user_name))
    typer.echo(
        f"{service.path} runs the agent; `journalctl {'--user ' * user}-u "
        f"{service.name}` shows its log"
        if is_started
        else f"{service.path} is written, and starts when systemd enables it: "
        f"`systemctl {'--user ' * user}enable --now {service.name}`"
    )
    if is_started and user:
        typer.echo("`loginctl enable-linger` lets it run when you are not logged in")


def uninstall_command(
    computer: ComputerName,
    robot: RobotName,
    user: _OwnUser = _IS_NOT_ROOT,
    unit_folder: _UnitFolder = None,
) -> None:
    """Stop the agent that systemd runs, with its containers, and remove the unit.

    Example: poise agent uninstall left --robot hello
    """
    service = AgentService(robot, computer, is_users=user, folder=unit_folder)
    service.uninstall()
    typer.echo(f"{service.path} is removed")
