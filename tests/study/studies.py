"""Small studies for tests: two methods, a few scenes, two seconds each."""

from collections.abc import Generator, Iterable
from pathlib import Path

from rcmservo.study.execution.chunk import ChunkRequest, RowValues, run_chunk
from rcmservo.study.execution.run_study import StudyExecution
from rcmservo.study.plan.file import StudyFile, make_plan
from rcmservo.study.plan.plan import StudyPlan


class InProcessPool:
    """Pool that runs every request in this process; test_study_workers.py has real workers."""

    count, where = 1, "this process"

    def run(
        self, requests: Iterable[tuple[str, ChunkRequest]]
    ) -> Generator[tuple[str, list[RowValues]]]:
        for key, request in requests:
            yield key, run_chunk(request)


def make_small_plan(**settings: object) -> StudyPlan:
    """Return a plan of two methods over 250 scenes, which are three chunks each."""
    defaults = {"methods": ("dlt", "projection"), "count": 250, "duration": 2.0}
    return make_plan(StudyFile(**{**defaults, **settings}), {})  # pyright: ignore[reportArgumentType]


def run_plan(plan: StudyPlan, folder: Path) -> StudyExecution:
    """Run all chunks of a plan."""
    execution = StudyExecution(plan, folder)
    execution.run(InProcessPool(), lambda _: None)  # pyright: ignore[reportArgumentType]
    return execution
