"""The keys of a robot: who may command its computers, and who may look."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, get_args

import typer
from msgspec import Struct

from poise.cli.options import AsJson, show
from poise.errors import PoiseError, UsageError, did_you_mean
from poise.session.arguments import check_name
from poise.session.keys import DAYS, MOST_DAYS, authority_of, init_keys
from poise.session.render.tables import table
from poise.units import quoted
from poise.wire.credentials import Credentials, Role, folders, minute

RobotName = Annotated[str, typer.Argument(help="The robot's name.", show_default=False)]
Folder = Annotated[
    Path | None, typer.Option(help="The owner's key folder. Default: the usual one.")
]
Out = Annotated[
    Path,
    typer.Option("--out", "-o", help="A folder in which each owner gets a folder."),
]


class KeysListed(Struct, frozen=True):
    """Keys of one participant; `expires`: when they end [s since 1970]."""

    robot: str
    name: str
    folder: str
    expires: float


def init_command(robot: RobotName, folder: Folder = None) -> None:
    """Make the authority that signs a robot's keys, once, and keys for you.

    Examples
    --------
    poise keys init hello
    """
    authority = init_keys(robot, folder)
    typer.echo(
        f"the authority of robot '{robot}' and your keys are in {authority.folder}"
    )
    typer.echo(
        f"next: `poise keys issue {robot} COMPUTER...` makes those of its computers"
    )


def issue_command(
    robot: RobotName,
    names: Annotated[
        list[str], typer.Argument(metavar="NAME...", help="Computers, or people.")
    ],
    out: Out = Path("keys"),
    role: Annotated[
        str,
        typer.Option(
            help="agent: a computer; manager: may command; viewer: may only watch."
        ),
    ] = "agent",
    days: Annotated[
        float, typer.Option(help="How long they are valid.", min=0.001)
    ] = DAYS,
    leads: Annotated[
        bool,
        typer.Option(
            "--leads",
            help="These computers may lead the robot (`manager:`); kept when renewed.",
        ),
    ] = False,
    folder: Folder = None,
) -> None:
    """Make or renew keys of computers or people, a folder each.

    Your own, which `init` made, are renewed, too, when they soon end.

    Examples
    --------
    poise keys issue hello left right

    poise keys issue hello left right --leads

    poise keys issue hello kim --role viewer --days 7
    """
    of_role = _role(role)
    if leads and of_role != "agent":
        raise UsageError(f"--leads is for computers, not with --role {role}")
    if not days <= MOST_DAYS:
        raise UsageError(f"--days {days:g}: it is {MOST_DAYS} at most")
    for name in names:
        if not name.strip(". ") or "/" in name or not name.isprintable():
            what = f"{quoted(name)} is no name: a folder in {out} is called so"
            raise UsageError(what)
        if of_role == "agent":
            check_name(name, "a computer's name")
    authority = authority_of(robot, folder)
    for name in names:
        issued = authority.issue(name, of_role, out / name, days=days)
        may_lead = leads or (of_role == "agent" and issued.to_lead.is_dir())
        if may_lead:
            authority.issue(name, "manager", issued.to_lead, days=days)
        also = ", also to lead the robot" if may_lead else ""
        until = minute(issued.expires)
        typer.echo(f"{issued.folder}: {issued.name}{also}, until {until}")
    own = _keys_in(authority.folder)
    if isinstance(own, str) or own.warning():  # nothing else renews what `init` made
        own = authority.issue("owner", "manager", authority.folder)
        typer.echo(f"{own.folder}: {own.name}, until {minute(own.expires)}")
    if issued.expires >= authority.ends.timestamp():
        typer.echo(
            f"the authority ends then, too: `poise keys rotate {robot}` makes another"
        )
    person, computer = folders(robot)
    typer.echo(
        f"next: copy each folder to its computer, as {computer} or where `--keys` or "
        "POISE_KEYS says, readable for its user alone, and start its agent (again)"
        if of_role == "agent"
        else f"next: give each folder to its person, as {person} or where POISE_KEYS "
        "says, readable for that person alone"
    )


def rotate_command(robot: RobotName, folder: Folder = None) -> None:
    """Take the next step from the robot's authority to another one.

    Three steps, with new keys for all after each: the first makes the next authority
    known, the second lets it sign, the third forgets the old one and what it signed.

    Examples
    --------
    poise keys rotate hello
    """
    authority = authority_of(robot, folder)
    signs = authority.rotate()
    authority.issue("owner", "manager", authority.folder)
    what = (
        "signs now; what the one before signed is accepted until the next `rotate`"
        if signs
        else "is known; it signs after the next `rotate`, and any before the present "
        "one is forgotten"
    )
    typer.echo(f"robot '{robot}': the next authority {what}")
    typer.echo(f"next: `poise keys issue {robot} ...` for all, and copy their folders")


def list_command(
    robot: Annotated[
        str | None, typer.Argument(help="The robot's name; else all robots.")
    ] = None,
    folder: Folder = None,
    as_json: AsJson = False,
) -> None:
    """Show the keys that this computer has, and until when they hold.

    Exits with 1 when some have ended or soon end, or are damaged.

    Examples
    --------
    poise keys list hello
    """
    if folder is not None and not folder.is_dir():
        raise UsageError(f"--folder {folder}: there is no such folder")
    places = [folder] if folder else _folders(robot)
    found = [_keys_in(place) for place in places if place.is_dir()]
    to_lead = [keys.to_lead for keys in found if isinstance(keys, Credentials)]
    found += [_keys_in(place) for place in to_lead if place.is_dir()]
    credentials = [keys for keys in found if isinstance(keys, Credentials)]
    if robot is not None and not found:
        where = " or ".join(map(str, places))
        raise UsageError(f"there are no keys of robot '{robot}' in {where}")
    shown = table("robot", "keys of", "until", "folder")
    for keys in credentials:
        shown.add_row(keys.robot, keys.name, minute(keys.expires), str(keys.folder))
    listed = [
        KeysListed(k.robot, k.name, str(k.folder), k.expires) for k in credentials
    ]
    show(listed, [shown], as_json=as_json)
    warnings = [keys for keys in found if isinstance(keys, str)]
    warnings += [warning for keys in credentials if (warning := keys.warning())]
    for warning in warnings:
        sys.stderr.write(f"{warning}\n")
    if warnings:
        raise typer.Exit(1)


def _keys_in(folder: Path) -> Credentials | str:
    """Return the keys in a folder, or what is wrong with them."""
    try:
        keys = Credentials(folder)
        _ = keys.expires  # it is read
    except PoiseError as error:
        return str(error)
    except OSError as error:  # those of another user
        return f"{folder} cannot be read: {error.strerror}"
    return keys


def _folders(robot: str | None) -> list[Path]:
    """Return where keys of a robot, or of all robots, may be."""
    if robot is not None:
        return folders(robot)
    parents = [place for place in folders("") if place.is_dir()]
    return [place for parent in parents for place in sorted(parent.iterdir())]


def _role(text: str) -> Role:
    roles: tuple[Role, ...] = get_args(Role)
    for role in roles:
        if role == text:
            return role
    guess = did_you_mean(text, roles)
    raise UsageError(f"--role {text}{guess}: it is {' or '.join(roles)}")


keys_command = list_command
