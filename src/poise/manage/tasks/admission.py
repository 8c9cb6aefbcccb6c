"""Room for the actions whose turn it is; who waits, or fails, when there is none."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from collections.abc import Set as AbstractSet

from msgspec.structs import replace

from poise.clock import boot_time
from poise.estimate.success.learning import learned
from poise.manage.adaptation.situation import Situation
from poise.manage.deploy.running_components import RunningComponents
from poise.manage.tasks.action_placement import PlanOverTime, Room, room_for_functions
from poise.manage.tasks.component_reports import Serving
from poise.manage.tasks.concurrent_tasks import Tasks
from poise.manage.tasks.learned_choice import conditions_of
from poise.manage.tasks.task_progress import TaskRecord, Try


class Admission:
    """Decides where the functions of all tasks go together."""

    def __init__(
        self, run: RunningComponents, tasks: Tasks, plans: PlanOverTime
    ) -> None:
        self._run = run
        self._tasks = tasks
        self._plans = plans
        self._serving = Serving(run)

    def look(
        self,
        situation: Situation,
        new: Iterable[tuple[TaskRecord, Try]],
        aside: AbstractSet[str],
        *,
        explore: bool,
    ) -> Room:
        """Return where all goes that should run now.

        When it does not fit, tasks of low priority wait for the room of others; when
        one does not even fit alone, its actions fail. The room then says why.
        """
        new = tuple(new)
        robot = learned(
            situation.robot,
            [each.action for _, each in new],
            conditions=conditions_of(situation),
            explore=explore,
            seed=self._tasks.saved.number,
        ).robot
        situation = replace(situation, robot=robot)
        left_out = aside | self._serving.broken(situation.lost)
        planned: dict[str, str] = {}
        for record, each in new:
            names = tuple(t.name for t in self._tasks.tries(record))
            planned |= self._plans.placement(record.name, names, each.action.functions)
        going = self._tasks.going()
        whole = self._beside(situation, going, left_out, planned)
        if not whole.why:
            return whole
        for count in range(len(going) - 1, 0, -1):
            if not self._beside(situation, going[:count], left_out, planned).why:
                others = " and ".join(f"'{each.name}'" for each in going[:count])
                for record in going[count:]:
                    text = f"task {others} uses the room that it needs: {whole.why}"
                    self._tasks.block(record.name, text)
                return whole
        self._end_or_block(going[0], whole.why)
        return whole

    def _end_or_block(self, record: TaskRecord, why: str) -> None:
        """End the actions that do not fit though no other task runs."""
        now = boot_time()
        for each in self._tasks.tries(record):
            if each.progress.since is None:
                self._tasks.end(each.number, now, f"it does not fit: {why}", done=False)
                return
        self._tasks.block(record.name, f"it does not fit any more: {why}")

    def _beside(
        self,
        situation: Situation,
        going: Sequence[TaskRecord],
        left_out: AbstractSet[str],
        planned: dict[str, str],
    ) -> Room:
        """Return where the functions of some tasks go, when all others rest."""
        functions = self._tasks.functions_of(going) | self._serving.fixed()
        functions -= left_out
        runs = situation.robot.components_for(functions)
        placement = {n: at for n, at in situation.placement.items() if n in runs}
        rest = self._run.prepared
        hint = {
            n: rest[n].computer if n in rest else at
            for n, at in planned.items()
            if n in runs
        }
        return room_for_functions(
            replace(situation, placement=placement), functions, hint
        )
