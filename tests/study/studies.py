"""Small studies for tests: two methods, a few scenes, two seconds each."""

from collections.abc import Generator, Iterable
from pathlib import Path

from rcmservo.study.execution.chunk import ChunkOrder, Numbers, done
from rcmservo.study.execution.run_study import Work
from rcmservo.study.plan.file import StudyFile, plan_of
from rcmservo.study.plan.plan import StudyPlan


class Alone:
    """A crew of one: this process. Real ones are in test_crew.py."""

    def done(
        self, orders: Iterable[tuple[str, ChunkOrder]]
    ) -> Generator[tuple[str, list[Numbers]]]:
        for key, order in orders:
            yield key, done(order)


def small(**choices: object) -> StudyPlan:
    """Two methods over 250 scenes, which are three chunks each."""
    usual = {"methods": ("dlt", "projection"), "count": 250, "duration": 2.0}
    return plan_of(StudyFile(**{**usual, **choices}), {})  # pyright: ignore[reportArgumentType]


def made(plan: StudyPlan, folder: Path) -> Work:
    """The study, done."""
    work = Work(plan, folder)
    work.go(Alone(), lambda _: None)  # pyright: ignore[reportArgumentType]
    return work
