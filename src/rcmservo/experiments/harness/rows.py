"""All claims as rows, and the first page made of them: one row for each sentence of the paper, its
cases in small tables, and what is ours apart."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from rcmservo.experiments.harness.claims import VERDICTS, Chapter, Claim
from rcmservo.experiments.harness.sentences import OURS, SENTENCES


@dataclass(frozen=True)
class ClaimRow:
    """A claim as it stands in claims.json."""

    experiment: str
    """The name of its experiment."""
    number: int
    """Its place among the claims of its experiment, from 0."""
    claim: str
    """What is measured, in words that are true or false."""
    whose: str
    """Whose sentence is judged: ours, the paper's, or one that follows from the paper's."""
    about: str
    """The sentence of the paper that it bears on, a key of SENTENCES; or OURS."""
    case: tuple[str, str]
    """Its row and column among the cases of the same words; empty where it has none."""
    where: str
    """Where in the paper that sentence stands; or OURS."""
    measured: float
    """The number, in ``unit``."""
    interval: tuple[float, float] | None
    """Between what the number is, with 95 %; None where that is not told, or the trials are too few
    for it."""
    unit: str
    """Of ``measured`` and ``bound``; empty for a plain number."""
    relation: str
    """<= or >=, as ``measured`` must stand to ``bound`` for the claim to hold."""
    bound: float
    """What ``measured`` is compared with."""
    verdict: str | None
    """None where one or two trials give none."""
    trials: int
    """How many the number came from; 0 for a computation without chance."""
    seed: list[int]
    """All that the number came from; empty for a computation without chance."""
    remark: str
    """Under which condition it holds, or why it does not; empty where that needs no words."""
    detail: str
    """What else was seen; may be empty."""
    figure: str
    """The name of the figure that shows it; empty where none does."""
    trap: str
    """The paper's pitfall (T1, ...) that the number bears on; empty where there is none."""
    trap_confirmed: bool | None
    """Whether the number confirms that pitfall; None without a pitfall or a verdict."""

    @property
    def anchor(self) -> str:
        """Where the claim stands in the report."""
        return f"{self.experiment}/claim-{self.number}"


def row_of(experiment: str, number: int, claim: Claim) -> ClaimRow:
    """The row of one claim."""
    return ClaimRow(
        experiment=experiment,
        number=number,
        claim=claim.claim,
        whose=claim.whose,
        about=claim.about,
        case=claim.case,
        where=claim.where,
        measured=float(claim.measured),
        interval=claim.sure,
        unit=claim.unit,
        relation=claim.relation,
        bound=float(claim.bound),
        verdict=claim.verdict,
        trials=claim.number,
        seed=[int(seed) for seed in claim.seeds],
        remark=claim.remarks,
        detail=claim.detail,
        figure=claim.figure,
        trap=claim.trap,
        trap_confirmed=claim.confirmed if claim.trap and claim.verdict is not None else None,
    )


def rows_of(chapters: Mapping[str, Chapter]) -> list[ClaimRow]:
    """All claims, in the order of the report."""
    return [
        row_of(name, i, claim)
        for name, chapter in chapters.items()
        for i, claim in enumerate(chapter.claims)
    ]


def counts(rows: Iterable[ClaimRow]) -> dict[str | None, int]:
    """How many rows have each verdict, and how many have none."""
    verdicts = [row.verdict for row in rows]
    return {verdict: verdicts.count(verdict) for verdict in (*VERDICTS, None)}


@dataclass(frozen=True)
class Cases:
    """The cases of one wording, as a small table."""

    claim: str
    """The wording."""
    rows: list[str]
    """Their labels, in the order of the cells."""
    columns: list[str]
    """Their labels; a single empty one where the rows tell the cases apart."""
    cells: list[list[ClaimRow | None]]
    """By row and column."""

    @property
    def first(self) -> ClaimRow:
        return next(row for cells in self.cells for row in cells if row is not None)


@dataclass(frozen=True)
class Judged:
    """A sentence, or a wording of ours, on the first page."""

    where: str
    """Where in the paper it stands; empty for ours."""
    words: str
    """The paper's, or those of our claim."""
    head: ClaimRow
    """The claim nearest to the words: the first one."""
    others: list[ClaimRow]
    """Other wordings."""
    cases: list[Cases]
    """A table for each wording that has several cases."""


def first_page(rows: list[ClaimRow]) -> tuple[list[Judged], list[Judged]]:
    """What the paper says, in its order, and what is ours."""
    papers = [
        judged(sentence.where, sentence.words, some)
        for about, sentence in SENTENCES.items()
        if (some := [row for row in rows if row.about == about])
    ]
    wordings = dict.fromkeys(row.claim for row in rows if row.about == OURS)
    ours = [
        judged("", claim, [row for row in rows if row.about == OURS and row.claim == claim])
        for claim in wordings
    ]
    return papers, ours


def judged(where: str, words: str, rows: list[ClaimRow]) -> Judged:
    """The rows of one sentence: its head, its other wordings, and tables of cases."""
    wordings = {claim: [row for row in rows if row.claim == claim] for claim in _claims(rows)}
    head = rows[0]
    singles = [some[0] for some in wordings.values() if len(some) == 1 and some[0] is not head]
    tables = [cases(some) for some in wordings.values() if len(some) > 1]
    return Judged(where, words, head, singles, tables)


def _claims(rows: list[ClaimRow]) -> list[str]:
    return list(dict.fromkeys(row.claim for row in rows))


def cases(rows: list[ClaimRow]) -> Cases:
    """The cases of one wording by their rows and columns."""
    names, columns = (list(dict.fromkeys(row.case[i] for row in rows)) for i in (0, 1))
    by_case = {row.case: row for row in rows}
    cells = [[by_case.get((name, column)) for column in columns] for name in names]
    return Cases(rows[0].claim, names, columns, cells)
