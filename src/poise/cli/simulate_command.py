"""`poise simulate`: what a task would do, in virtual time and under faults."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from poise.cli.main import Interrupts
from poise.cli.options import (
    AnyMethod,
    AsJson,
    RobotFile,
    RobotTask,
    Set,
    arguments_of,
    positive_seconds,
    print_json,
    try_write,
)
from poise.errors import UsageError
from poise.model.loading import load
from poise.session.folders import to_write
from poise.session.placing.placement import place
from poise.session.profiling.stored_profiles import profiled
from poise.session.render.printable import console_to
from poise.session.render.run_progress import virtual_progress
from poise.session.robot_file import task_of, with_code
from poise.session.simulate import (
    Simulation,
    SimulationComparison,
    compare_simulations,
    simulate,
)


def simulate_command(
    file: RobotFile,
    task: RobotTask = None,
    placement: AnyMethod = None,
    for_: Annotated[
        str, typer.Option("--for", help="Virtual time, such as 10min or 1h.")
    ] = "1min",
    faults: Annotated[
        str | None,
        typer.Option(help="File with faults, or random: the seed picks them."),
    ] = None,
    seed: Annotated[
        int, typer.Option(help="Seed of chance: the same seed gives the same outcome.")
    ] = 0,
    adapt: Annotated[
        bool, typer.Option(help="Change the placement as `poise up` does.")
    ] = True,
    recording: Annotated[
        Path | None,
        typer.Option(
            help="What `poise up --record` wrote: the load, second by second. Or a bag "
            "of ROS 2: what comes by bridges."
        ),
    ] = None,
    compare: Annotated[
        str | None, typer.Option(help="Placements side by side: auto,static,greedy.")
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option(help="File for a page with pictures.", callback=to_write),
    ] = None,
    set_: Set = None,
    as_json: AsJson = False,
) -> None:
    """Simulate a task in virtual time: what is late, moves or stops, and for how long.

    Poise's own manager and agents run, on simulated computers. Components take what
    profile and robot file say; their classes say which ports and timers there are, and
    none of their handlers runs. Ctrl-C ends it early, and the report has what is known
    by then.

    The exit code is 1 when the robot does not come up, or a promise of Poise did not
    hold. Missed deadlines are no error.

    Examples
    --------
    poise simulate robot.yaml --task fetch --for 1h

    poise simulate robot.yaml --for 30min --faults faults.yaml --html page.html

    poise simulate robot.yaml --for 1h --faults random --seed 7 --compare auto,static
    """
    seconds = positive_seconds(for_, "a simulation")
    if compare is not None and placement is not None:
        raise UsageError(
            f"--compare {compare} and --placement {placement} together: add "
            f"{placement} to --compare"
        )
    console = console_to(stderr=True)
    robot = profiled(with_code(load(file, arguments_of(set_))), console.say)
    chosen = task_of(robot, task)
    run: Callable[..., Simulation | SimulationComparison]
    if compare is None:
        placed = place(robot, chosen, method=placement or "auto", fewer=True)
        run = partial(simulate, placement=placed)
    else:
        methods = [method.strip() for method in compare.split(",")]
        run = partial(compare_simulations, methods=methods)
    with Interrupts() as interrupts:
        with virtual_progress(console, seconds) as show:
            result = run(
                robot,
                chosen,
                seconds=seconds,
                faults=faults or (),
                seed=seed,
                adapt=adapt,
                recording=recording,
                say=console.say,
                meanwhile=show,
                check=interrupts.check,
            )
        is_kept = html is None or try_write(html, result.page(), console.say)
        if as_json:
            print_json(result)
        else:
            console_to().print(result)
    if result.failed or not is_kept:
        raise typer.Exit(1)
