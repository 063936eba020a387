"""The pages that cite studies: generated from their templates and results that support them."""

import importlib
import re
from pathlib import Path
from typing import Any

import pytest

from conftest import ROOT

STUDIES = sorted((ROOT / "docs/studies").rglob("*.toml"))
PAGES = "how_to_choose", "imperfect_arms"
RESULT_PATTERN = re.compile(r"\d\s*(%|mm\b|s\b(?!tudy))")
"""Figure with the unit of a result; settings in px, Hz and ms are not results."""


@pytest.fixture
def choosing(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Module that writes the pages."""
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    return importlib.import_module("choosing")


@pytest.fixture(params=PAGES)
def page(request: pytest.FixtureRequest, choosing: Any) -> Any:
    """Each page that cites studies."""
    (one,) = [page for page in choosing.PAGES if page.name == request.param]
    return one


def test_the_pages_are_known(choosing: Any) -> None:
    assert tuple(page.name for page in choosing.PAGES) == PAGES


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_every_study_of_a_page_can_be_planned(path: Path) -> None:
    from rcmservo.study.plan.file import make_plan, read_study_file

    plan = make_plan(read_study_file(path), {})
    assert 0 < plan.runs <= 10_000
    assert len(plan.cells) > 1


def test_every_study_of_a_page_has_results_and_is_named_on_it(choosing: Any, page: Any) -> None:
    figures, text = choosing.load(page.figures), page.path.read_text()
    assert sorted(figures["studies"]) == page.list_studies()
    for name, study in figures["studies"].items():
        assert f"([{name}])" in text or f"[{name}]," in text, f"no sentence is of {name}"
        assert study["question"].endswith("?") and f"`{study['command']}`" in text


def test_a_page_is_generated_from_its_template_and_its_results(page: Any) -> None:
    """No figure is typed by hand, and the results support every sentence."""
    assert page.render() == page.path.read_text()


@pytest.mark.parametrize("name", PAGES)
def test_the_sentences_of_a_template_contain_no_result(name: str) -> None:
    template = (ROOT / f"docs/{name}.md.j2").read_text()
    text = re.sub(r"\{\{.*?\}\}|\{%.*?%\}", " ", template, flags=re.S)
    text = re.sub(r"`[^`]*`|^#.*$", " ", text, flags=re.M)
    assert [match[0] for match in RESULT_PATTERN.finditer(text)] == []


@pytest.mark.parametrize("text", ["in 98 % of", "after 1.9 s", "0.04 mm off", "ends 3mm off"])
def test_results_are_recognised_by_their_unit(text: str) -> None:
    assert RESULT_PATTERN.search(text)


ROWS = {"random": {"a": {"success": [0.5, 0.4, 0.6], "runs": 10, "stops": {"SINGULAR": 2}}}}
COMPARISONS = {"random": {"b": {"success": [-0.1, -0.2, -0.02], "time_s": [None, None, None]}}}
FIGURES = {"studies": {"one": {"rows": ROWS, "beside": COMPARISONS}}}
"""Results of a minimal study."""


@pytest.mark.parametrize(
    ("claim", "holds"),
    [
        ('worse("one", "b", "random")', True),
        ('better("one", "b", "random")', False),
        ('alike("one", "b", "random")', False),
        ('at_least(0.4, "one", "a", "random")', True),
        ('at_most(0.5, "one", "a", "random")', False),
        ('stopped_by("SINGULAR", 0.2, "one", "a", "random")', True),
        ('below(("one", "a", "random"), ("one", "a", "random"))', False),
    ],
)
def test_a_sentence_without_support_by_the_results_is_refused(
    choosing: Any, tmp_path: Path, claim: str, holds: bool
) -> None:
    sentence = (
        f'{{% call says({claim}) %}}It is {{{{ share("one", "a", "random") }}}}.{{% endcall %}}'
    )
    (tmp_path / "page.j2").write_text(sentence)
    if holds:
        written = choosing.render(FIGURES, tmp_path, "page.j2")
        assert written == "It is 50.0 % (40.0 to 60.0). ([one])\n"
        return
    with pytest.raises(choosing.UnsupportedClaim, match=r"claim 1 of: It is 50\.0 %"):
        choosing.render(FIGURES, tmp_path, "page.j2")


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ('{{ share("one", "a", "random") }}', "are outside a call of says"),
        (
            '{% call says(better("one", "b", "random", "time_s")) %}x{% endcall %}',
            "time_s of b in random is unknown",
        ),
        (
            '{% call says() %}{{ share("one", "c", "random") }}{% endcall %}',
            "one has no c in random",
        ),
    ],
)
def test_a_result_without_a_source_is_refused(
    choosing: Any, tmp_path: Path, text: str, error: str
) -> None:
    (tmp_path / "page.j2").write_text(text)
    with pytest.raises((choosing.UnsupportedClaim, ValueError, KeyError), match=error):
        choosing.render(FIGURES, tmp_path, "page.j2")


@pytest.mark.slow
def test_a_study_gives_results_and_a_page(
    choosing: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Run `make studies` with a study of four runs."""
    make = importlib.import_module("make_studies")
    (tmp_path / "docs").mkdir()
    monkeypatch.setattr(make, "ROOT", tmp_path)
    page = choosing.StudyPage("page", tmp_path / "docs/studies")
    page.studies.mkdir()
    methods = 'methods = ["dlt", "projection"]\ncount = 2\n'
    (page.studies / "tiny.toml").write_text(f"# Does it\n# run? So it seems.\n{methods}")
    (tmp_path / "docs/page.j2").write_text(
        '{{ table("tiny", "share time error ratio unnoticed", stops=True) }}\n'
    )
    make.run(page, "tiny", 1)
    make.write(page, make.collect_figures(page))
    figures = choosing.load(page.figures)
    assert figures["studies"]["tiny"]["question"] == "Does it run?"
    text = choosing.render(figures, tmp_path / "docs", "page.j2")
    assert re.search(r"^\| `dlt` \| [\d.]+ % \([\d.]+ to [\d.]+\) \| [\d.]+ s", text, re.M)
    assert text.endswith("([tiny])\n")
