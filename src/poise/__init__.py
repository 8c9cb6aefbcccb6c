"""Poise keeps a robot's software in balance over its on-board computers.

`load`, `place`, `run` and `up` are the application; `Component` and its ports are what
a robot's code is written with.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from poise import emulate as emulate
    from poise import model as model
    from poise import plan as plan
    from poise import testing as testing
    from poise import units as units
    from poise.clock import Stamp as Stamp
    from poise.errors import AlreadyManaged as AlreadyManaged
    from poise.errors import CalleeError as CalleeError
    from poise.errors import CallError as CallError
    from poise.errors import CannotCross as CannotCross
    from poise.errors import FileProblem as FileProblem
    from poise.errors import PoiseError as PoiseError
    from poise.errors import RobotError as RobotError
    from poise.errors import RunError as RunError
    from poise.errors import TakenOver as TakenOver
    from poise.errors import Timeout as Timeout
    from poise.errors import Unavailable as Unavailable
    from poise.errors import UsageError as UsageError
    from poise.estimate.outcomes import Conditions as Conditions
    from poise.estimate.outcomes import note_outcome as note_outcome
    from poise.manage.journal import JournalEntry as JournalEntry
    from poise.manage.journal import read_journal as read_journal
    from poise.model.policy import PolicyAction as PolicyAction
    from poise.model.policy import Seen as Seen
    from poise.model.robot import Robot as Robot
    from poise.runtime.component.component import Component as Component
    from poise.runtime.component.component import time_left as time_left
    from poise.runtime.component.component import within as within
    from poise.runtime.component.ports import Message as Message
    from poise.runtime.component.ports import Provided as Provided
    from poise.runtime.component.ports import Published as Published
    from poise.runtime.component.ports import Required as Required
    from poise.runtime.component.ports import every as every
    from poise.runtime.component.ports import found as found
    from poise.runtime.component.ports import lost as lost
    from poise.runtime.component.ports import oneway as oneway
    from poise.runtime.component.ports import published as published
    from poise.runtime.component.ports import subscribed as subscribed
    from poise.runtime.component.started_calls import StartedCall as StartedCall
    from poise.session.deploy.deploy import Deployed as Deployed
    from poise.session.deploy.deploy import deploy as deploy
    from poise.session.diagrams.draw import Drawing as Drawing
    from poise.session.diagrams.draw import draw as draw
    from poise.session.launch.computers import emulated as emulated
    from poise.session.placing.placement import Placement as Placement
    from poise.session.placing.placement import place as place
    from poise.session.profiling.calibrate import Calibration as Calibration
    from poise.session.profiling.calibrate import calibrate as calibrate
    from poise.session.profiling.profile_robot import Profiling as Profiling
    from poise.session.profiling.profile_robot import profile as profile
    from poise.session.recorded_run import PolicyEvent as PolicyEvent
    from poise.session.recorded_run import RecordedRun as RecordedRun
    from poise.session.recorded_run import test_policies as test_policies
    from poise.session.render.status_tables import Status as Status
    from poise.session.robot_file import check as check
    from poise.session.robot_file import load as load
    from poise.session.run import run as run
    from poise.session.run_report import RunReport as RunReport
    from poise.session.running_robots.playback import Playback as Playback
    from poise.session.running_robots.playback import play as play
    from poise.session.running_robots.running import NoManager as NoManager
    from poise.session.running_robots.running import RolledBack as RolledBack
    from poise.session.running_robots.running import Running as Running
    from poise.session.running_robots.running import connect as connect
    from poise.session.running_robots.running_component import (
        RunningComponent as RunningComponent,
    )
    from poise.session.running_robots.without_manager import (
        status_without_manager as status_without_manager,
    )
    from poise.session.running_robots.without_manager import (
        stop_without_manager as stop_without_manager,
    )
    from poise.session.simulate import Simulation as Simulation
    from poise.session.simulate import SimulationComparison as SimulationComparison
    from poise.session.simulate import compare_simulations as compare_simulations
    from poise.session.simulate import simulate as simulate
    from poise.session.up import up as up
    from poise.simulation.faults import SimulatedFault as SimulatedFault
    from poise.view.robot_recording import RobotRecording as RobotRecording
    from poise.view.robot_recording import record as record
    from poise.wire.connections.blocks import loan as loan
else:
    _HOMES = {
        "AlreadyManaged": "errors",
        "Calibration": "session.profiling.calibrate",
        "CallError": "errors",
        "CalleeError": "errors",
        "CannotCross": "errors",
        "Component": "runtime.component.component",
        "Deployed": "session.deploy.deploy",
        "Drawing": "session.diagrams.draw",
        "FileProblem": "errors",
        "JournalEntry": "manage.journal",
        "Message": "runtime.component.ports",
        "NoManager": "session.running_robots.running",
        "Playback": "session.running_robots.playback",
        "Placement": "session.placing.placement",
        "PoiseError": "errors",
        "PolicyAction": "model.policy",
        "PolicyEvent": "session.recorded_run",
        "Profiling": "session.profiling.profile_robot",
        "Provided": "runtime.component.ports",
        "Published": "runtime.component.ports",
        "RecordedRun": "session.recorded_run",
        "Required": "runtime.component.ports",
        "Robot": "model.robot",
        "RobotError": "errors",
        "RobotRecording": "view.robot_recording",
        "RolledBack": "session.running_robots.running",
        "RunError": "errors",
        "RunReport": "session.run_report",
        "RunningComponent": "session.running_robots.running_component",
        "StartedCall": "runtime.component.started_calls",
        "Running": "session.running_robots.running",
        "Seen": "model.policy",
        "Conditions": "estimate.outcomes",
        "SimulatedFault": "simulation.faults",
        "Simulation": "session.simulate",
        "SimulationComparison": "session.simulate",
        "Stamp": "clock",
        "Status": "session.render.status_tables",
        "TakenOver": "errors",
        "Timeout": "errors",
        "Unavailable": "errors",
        "UsageError": "errors",
        "calibrate": "session.profiling.calibrate",
        "check": "session.robot_file",
        "compare_simulations": "session.simulate",
        "connect": "session.running_robots.running",
        "deploy": "session.deploy.deploy",
        "draw": "session.diagrams.draw",
        "emulated": "session.launch.computers",
        "every": "runtime.component.ports",
        "found": "runtime.component.ports",
        "load": "session.robot_file",
        "loan": "wire.connections.blocks",
        "lost": "runtime.component.ports",
        "note_outcome": "estimate.outcomes",
        "oneway": "runtime.component.ports",
        "place": "session.placing.placement",
        "play": "session.running_robots.playback",
        "profile": "session.profiling.profile_robot",
        "read_journal": "manage.journal",
        "record": "view.robot_recording",
        "run": "session.run",
        "simulate": "session.simulate",
        "status_without_manager": "session.running_robots.without_manager",
        "stop_without_manager": "session.running_robots.without_manager",
        "published": "runtime.component.ports",
        "subscribed": "runtime.component.ports",
        "test_policies": "session.recorded_run",
        "time_left": "runtime.component.component",
        "up": "session.up",
        "within": "runtime.component.component",
    }
    _PARTS = ("emulate", "model", "plan", "testing", "units")
    __all__ = list(_HOMES)

    def __dir__() -> list[str]:
        """Return the public names, whether they are imported already or not."""
        return sorted([*__all__, "__version__"])

    def __getattr__(name: str) -> object:
        """Import a name when it is first asked for, so that `import poise` is quick."""
        if name == "__version__":
            found: object = import_module("poise.version").VERSION
        elif name in _PARTS:
            found = import_module(f"poise.{name}")
        elif name in _HOMES:
            found = getattr(import_module(f"poise.{_HOMES[name]}"), name)
        else:
            raise AttributeError(f"module 'poise' has no attribute '{name}'")
        globals()[name] = found
        return found
