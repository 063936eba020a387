"""What the documents say is true: names exist, links lead somewhere, examples and commands run."""

import ast
import importlib
import itertools
import re
import shlex
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from conftest import DATA, ROOT
from rcmservo.experiments.harness.paper import EXPERIMENTS
from rcmservo.guard.causes import Cause
from stalls import undisturbed

SOURCE = ROOT / "src/rcmservo"
README = (ROOT / "README.md").read_text()
NAMES = re.findall(r"`(rcmservo[\w.]*):([\w.]+)`", (ROOT / "docs/notation.md").read_text())
WORDS = re.findall(
    r"^\| (\w+) \| `rcmservo[\w.]*:[\w.]+` \| (\S.*\S) \|$",
    (ROOT / "docs/notation.md").read_text().partition("## The words of the house")[2],
    re.M,
)
COMMANDS = [
    line for block in re.findall(r"```sh\n(.*?)```", README, re.S) for line in block.splitlines()
]
SET_UP = {"make run", "make test"}
SERVES = {".venv/bin/rcmservo serve"}
"""What tests/page follows step by step."""


@pytest.mark.parametrize("name", NAMES, ids=":".join)
def test_every_name_in_the_notation_exists(name: tuple[str, str]) -> None:
    place = importlib.import_module(name[0])
    for part in name[1].split("."):
        fields = getattr(place, "__dataclass_fields__", {})
        assert part in fields or hasattr(place, part)
        place = getattr(place, part, None)


def test_the_notation_names_something() -> None:
    assert len(NAMES) > 60


def test_every_word_of_the_house_means_one_thing() -> None:
    table = (ROOT / "docs/notation.md").read_text().partition("## The words of the house")[2]
    words, meanings = zip(*WORDS, strict=True)
    assert (
        len(WORDS) == table.count("\n| ") - 1
    )  # every row but the heading has word, code, meaning
    assert len(set(words)) == len(set(meanings)) == len(words)


def test_hello_world_in_the_readme_is_the_example() -> None:
    block = re.search(r"```python\n(.*?)```", README, re.S)
    assert block is not None
    assert block[1] == (ROOT / "examples/01_hello.py").read_text()


def unexplained(path: Path) -> Iterator[str]:
    """The public fields of a file that no string below them explains."""
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.ClassDef) or node.name.startswith("_"):
            continue
        kind = " ".join(map(ast.unparse, [*node.decorator_list, *node.bases]))
        if "dataclass" in kind or "NamedTuple" in kind:
            for field, below in itertools.pairwise([*node.body, ast.Pass()]):
                told = isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant)
                if isinstance(field, ast.AnnAssign) and not told:
                    yield f"{path.name}: {node.name}.{ast.unparse(field.target)}"


def test_no_two_public_classes_share_a_name() -> None:
    """But for the settings of the experiments, of which each has its own."""
    public = [
        node.name
        for path in SOURCE.rglob("*.py")
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
        if not (node.name == "Settings" and path.parent == SOURCE / "experiments")
    ]
    assert [name for name, count in Counter(public).items() if count > 1] == []


def test_no_folder_holds_more_files_than_a_reader_can_keep_in_mind() -> None:
    """The experiments excepted, one file for each claim."""
    folders = [path for path in SOURCE.rglob("*") if path.is_dir() and path.name != "experiments"]
    counts = {path.name: len(list(path.glob("*.py"))) for path in folders}
    assert len(counts) > 10
    assert {name: count for name, count in counts.items() if count > 15} == {}


def test_every_field_is_explained_beside_it() -> None:
    files = sorted(SOURCE.rglob("*.py"))
    assert [name for path in files for name in unexplained(path)] == []


@pytest.mark.parametrize("link", sorted(set(re.findall(r"\]\((?!https?:)([^)#]+)\)", README))))
def test_every_link_of_the_readme_leads_somewhere(link: str) -> None:
    assert (ROOT / link).exists()


def test_the_table_of_causes_is_that_of_the_code() -> None:
    rows = re.findall(
        r"^\| `(\w+)` \| (\w+) \| (.*?) \| (.*?) \|$", (ROOT / "docs/faults.md").read_text(), re.M
    )
    told = [
        (cause.name, cause.action.name, cause.value, cause.way_out)
        for cause in Cause
        if cause is not Cause.NONE
    ]
    assert rows == told


def test_the_set_up_commands_are_targets_of_the_makefile_and_ci_calls_the_test_command() -> None:
    assert set(COMMANDS) >= SET_UP
    targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.M)
    assert {command.split()[1] for command in SET_UP} <= set(targets)
    assert "make test" in (ROOT / ".ci/run").read_text()


def test_the_readme_names_every_experiment() -> None:
    section = README.split("## The paper's experiments")[1].split("## ")[0]
    named = re.findall(r"`([a-z0-9-]+)`", section)
    assert [name for name in named if not name.startswith("--")] == list(EXPERIMENTS)


@pytest.mark.slow
@pytest.mark.alone
@pytest.mark.parametrize("command", [one for one in COMMANDS if one not in SET_UP | SERVES])
def test_every_other_command_of_the_readme_runs(command: str, tmp_path: Path) -> None:
    words = shlex.split(command)
    assert words[0] == ".venv/bin/rcmservo"
    if "../shared" in command and not DATA.exists():
        pytest.skip("../shared/data is not here")
    words[0] = str(Path(sys.executable).with_name("rcmservo"))
    folders = map(tmp_path.joinpath, "abcdef")

    def attempt() -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [*words, "--out", str(next(folders))],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
        )

    ran = undisturbed if words[1] == "live" else lambda run, _: run()
    done = ran(attempt, lambda run: run.returncode == 0)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_hello_world_arrives() -> None:
    done = subprocess.run(
        [sys.executable, ROOT / "examples/01_hello.py"],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    )
    phase, s, r, d = re.match(
        r"(\w+): Δs = (\S+) rad, Δr = (\S+) px, Δd = (\S+) px", done.stdout
    ).groups()  # type: ignore[union-attr]
    assert phase == "servoing"
    assert abs(float(s)) < 0.009
    assert max(abs(float(r)), abs(float(d))) < 1.0


def test_citation_and_package_agree_on_the_version() -> None:
    import rcmservo

    assert f"version: {rcmservo.__version__}\n" in (ROOT / "CITATION.cff").read_text()
    assert f'version = "{rcmservo.__version__}"' in (ROOT / "pyproject.toml").read_text()


CHOOSING = ROOT / "docs/studies"
STUDIES = sorted(path.stem for path in CHOOSING.glob("*.toml"))
TEMPLATE = ROOT / "docs/how_to_choose.md.j2"
RESULT = re.compile(r"\d\s*(%|mm\b|s\b(?!tudy))")
"""A figure with the unit of a result. Settings of px, Hz and ms are none."""


@pytest.fixture
def choosing(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The module that writes docs/how_to_choose.md."""
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    return importlib.import_module("choosing")


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_behind_the_page_can_be_planned(name: str) -> None:
    from rcmservo.study.plan.file import load, plan_of

    plan = plan_of(load(CHOOSING / f"{name}.toml"), {})
    assert 0 < plan.runs <= 10_000
    assert len(plan.cells) > 1


def test_every_study_behind_the_page_has_its_figures_and_is_named_on_it(choosing: Any) -> None:
    figures, page = choosing.load(), choosing.PAGE.read_text()
    assert sorted(figures["studies"]) == STUDIES
    for name, study in figures["studies"].items():
        assert f"([{name}])" in page or f"[{name}]," in page, f"no sentence is of {name}"
        assert study["question"].endswith("?") and f"`{study['command']}`" in page


def test_the_page_on_how_to_choose_is_what_its_template_and_its_figures_make(choosing: Any) -> None:
    """So none of its figures was typed by hand, and the figures bear every sentence."""
    assert choosing.render(choosing.load()) == choosing.PAGE.read_text()


def test_no_figure_stands_in_the_sentences_of_the_template() -> None:
    text = re.sub(r"\{\{.*?\}\}|\{%.*?%\}", " ", TEMPLATE.read_text(), flags=re.S)
    text = re.sub(r"`[^`]*`|^#.*$", " ", text, flags=re.M)
    assert [match[0] for match in RESULT.finditer(text)] == []


@pytest.mark.parametrize("text", ["in 98 % of", "after 1.9 s", "0.04 mm off", "ends 3mm off"])
def test_a_figure_is_known_when_it_is_seen(text: str) -> None:
    assert RESULT.search(text)


ROWS = {"random": {"a": {"success": [0.5, 0.4, 0.6], "runs": 10, "stops": {"SINGULAR": 2}}}}
BESIDE = {"random": {"b": {"success": [-0.1, -0.2, -0.02], "time_s": [None, None, None]}}}
FIGURES = {"studies": {"one": {"rows": ROWS, "beside": BESIDE}}}
"""Of a study as small as can be."""


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
def test_a_sentence_that_the_figures_do_not_bear_is_not_written(
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
    with pytest.raises(choosing.Unborne, match=r"claim 1 of: It is 50\.0 %"):
        choosing.render(FIGURES, tmp_path, "page.j2")


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ('{{ share("one", "a", "random") }}', "stand outside any sentence"),
        (
            '{% call says(better("one", "b", "random", "time_s")) %}x{% endcall %}',
            "nothing is known",
        ),
        (
            '{% call says() %}{{ share("one", "c", "random") }}{% endcall %}',
            "one has no c in random",
        ),
    ],
)
def test_a_figure_without_a_source_is_refused(
    choosing: Any, tmp_path: Path, text: str, error: str
) -> None:
    (tmp_path / "page.j2").write_text(text)
    with pytest.raises((choosing.Unborne, ValueError, KeyError), match=error):
        choosing.render(FIGURES, tmp_path, "page.j2")


@pytest.mark.slow
def test_a_study_becomes_figures_and_a_page(
    choosing: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As `make studies` does it, with a study of four runs."""
    make = importlib.import_module("make_studies")
    (tmp_path / "docs").mkdir()
    monkeypatch.setattr(make, "ROOT", tmp_path)
    for place in (make, choosing):
        monkeypatch.setattr(place, "STUDIES", tmp_path / "docs/studies")
        monkeypatch.setattr(place, "FIGURES", tmp_path / "docs/studies/figures.json")
    choosing.STUDIES.mkdir()
    methods = 'methods = ["dlt", "projection"]\ncount = 2\n'
    (choosing.STUDIES / "tiny.toml").write_text(f"# Does it\n# run? So it seems.\n{methods}")
    (tmp_path / "docs/page.j2").write_text(
        '{{ table("tiny", "share time error ratio unnoticed", stops=True) }}\n'
    )
    make.run("tiny", 1)
    make.write(make.gathered())
    figures = choosing.load(choosing.FIGURES)
    assert figures["studies"]["tiny"]["question"] == "Does it run?"
    page = choosing.render(figures, tmp_path / "docs", "page.j2")
    assert re.search(r"^\| `dlt` \| [\d.]+ % \([\d.]+ to [\d.]+\) \| [\d.]+ s", page, re.M)
    assert page.endswith("([tiny])\n")
