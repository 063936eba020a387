"""Documents: their names exist, their links resolve, their examples and commands run."""

import ast
import importlib
import re
import runpy
import shlex
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any, TypeGuard

import pytest

from conftest import ROOT, SMALL_RIG_TOML
from rcmservo.cli.cli import main
from rcmservo.paper.claims import claim_table
from rcmservo.safety.causes import Cause
from rcmservo.study.execution import workers
from rcmservo.study.execution.chunk import run_chunk
from stalls import retry_after_stalls

SOURCE = ROOT / "src/rcmservo"
README = (ROOT / "README.md").read_text()
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").glob("*.md")])
NAMES = re.findall(r"`(rcmservo[\w.]*):([\w.]+)`", (ROOT / "docs/notation.md").read_text())
WORDS = re.findall(
    r"^\| ([\w ]+) \| `rcmservo[\w.]*:[\w.]+` \| (\S.*\S) \|$",
    (ROOT / "docs/notation.md").read_text().partition("## Glossary")[2],
    re.M,
)


def list_commands(*pages: str) -> list[str]:
    """Return the commands in the shell blocks of pages, each once."""
    texts = [(ROOT / page).read_text() for page in pages]
    blocks = [block for text in texts for block in re.findall(r"```sh\n(.*?)```", text, re.S)]
    return list(dict.fromkeys(line for block in blocks for line in block.splitlines()))


COMMANDS = list_commands("README.md", "docs/command_line.md", "docs/paper.md")
SET_UP_COMMANDS = {"make run", "make test"}
MAX_LINES, MAX_WORDS, MAX_CELL_WORDS = 130, 1200, 15
"""Size limits of the README, for a reader with a few minutes."""
SEARCH_TERMS = (
    "visual servoing", "image-based", "pose-based", "eye-to-hand", "hand-eye calibration",
    "dVRK", "ViSP",
)  # fmt: skip
"""Search terms for software of this kind."""


@pytest.mark.parametrize("name", NAMES, ids=":".join)
def test_every_name_in_the_notation_exists(name: tuple[str, str]) -> None:
    owner = importlib.import_module(name[0])
    for part in name[1].split("."):
        fields = getattr(owner, "__dataclass_fields__", {})
        assert part in fields or hasattr(owner, part)
        owner = getattr(owner, part, None)


def test_the_notation_has_names() -> None:
    assert len(NAMES) > 60


def test_every_term_has_one_meaning() -> None:
    table = (ROOT / "docs/notation.md").read_text().partition("## Glossary")[2]
    words, meanings = zip(*WORDS, strict=True)
    assert (
        len(WORDS) == table.count("\n| ") - 1
    )  # every row but the heading has word, code, meaning
    assert len(set(words)) == len(set(meanings)) == len(words)


def test_the_program_of_the_readme_is_the_example() -> None:
    block = re.search(r"```python\n(.*?)```", README, re.S)
    assert block is not None
    assert block[1] == (ROOT / "examples/00_readme.py").read_text()
    assert len(list(filter(None, block[1].splitlines()))) <= 12


def test_the_readme_is_short_and_has_the_search_terms() -> None:
    assert len(README.splitlines()) <= MAX_LINES
    assert len(README.split()) <= MAX_WORDS
    rows = [line for line in README.splitlines() if line.startswith("|")]
    cells = [cell for row in rows for cell in row.strip("|").split("|")]
    assert [cell for cell in cells if len(cell.split()) > MAX_CELL_WORDS] == []
    assert [word for word in SEARCH_TERMS if word not in README] == []
    assert max(path.stat().st_size for path in list_images(README)) <= 1.5e6


def list_images(text: str) -> list[Path]:
    """Return the images of a page."""
    return [ROOT / name for name in re.findall(r"!\[[^]]*\]\(([^)]+)\)", text)]


def find_undescribed_fields(path: Path) -> Iterator[str]:
    """Yield public fields that the Parameters section of their class does not describe."""
    text = path.read_text()
    has_fields = "dataclass" in text or "NamedTuple" in text
    for node in ast.walk(ast.parse(text)) if has_fields else ():
        if not isinstance(node, ast.ClassDef) or node.name.startswith("_"):
            continue
        kind = " ".join(map(ast.unparse, [*node.decorator_list, *node.bases]))
        if "dataclass" in kind or "NamedTuple" in kind:
            described = set(re.findall(r"^(\w+) : .*\n +\S", ast.get_docstring(node) or "", re.M))
            for field in node.body:
                name = ast.unparse(field.target) if is_parameter(field) else None
                if name and name not in described:
                    yield f"{path.name}: {node.name}.{name}"


def is_parameter(field: ast.stmt) -> TypeGuard[ast.AnnAssign]:
    """Return True for a field that is no class variable and no column of the record.

    A column carries its description itself.
    """
    if not isinstance(field, ast.AnnAssign) or "ClassVar" in ast.unparse(field.annotation):
        return False
    return field.value is None or not ast.unparse(field.value).startswith("column(")


def test_no_two_public_classes_share_a_name() -> None:
    texts = [path.read_text() for path in SOURCE.rglob("*.py")]
    public = [name for text in texts for name in re.findall(r"^class ([A-Za-z]\w*)", text, re.M)]
    assert len(public) > 500
    assert [name for name, count in Counter(public).items() if count > 1] == []


def test_no_folder_has_more_than_15_files() -> None:
    """The folder of the experiments, with one file for each claim, is an exception."""
    folders = [path for path in SOURCE.rglob("*") if path.is_dir() and path.name != "paper"]
    counts = {path.name: len(list(path.glob("*.py"))) for path in folders}
    assert len(counts) > 10
    assert {name: count for name, count in counts.items() if count > 15} == {}


def test_every_field_is_described_in_the_parameters_of_its_class() -> None:
    files = sorted(SOURCE.rglob("*.py"))
    assert [name for path in files for name in find_undescribed_fields(path)] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_of_a_page_resolves(page: Path) -> None:
    links = re.findall(r"\]\((?!https?:)([^)#]*)#?([^)]*)\)", page.read_text())
    targets = [(page.parent / file if file else page, anchor) for file, anchor in links]
    assert [str(path) for path, _ in targets if not path.exists()] == []
    anchored = [(path, anchor) for path, anchor in targets if anchor and path.suffix == ".md"]
    assert [
        (path.name, anchor) for path, anchor in anchored if anchor not in list_anchors(path)
    ] == []


def list_anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.M)
    words = [re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings]
    return {text.replace(" ", "-") for text in words}


PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
FILE_REFERENCE = re.compile(r"(?<![\w./-])(?:benchmarks|docs|examples|tests)/[\w./-]*\w")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_file_of_the_repository_that_a_page_names_exists(page: Path) -> None:
    named = set(FILE_REFERENCE.findall(page.read_text()))
    assert sorted(name for name in named if not (ROOT / name).exists()) == []


def test_the_table_of_causes_is_generated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    tables, page = importlib.import_module("make_fault_table"), ROOT / "docs/faults.md"
    assert tables.with_table(page.read_text()) == page.read_text()
    assert page.read_text().count("\n| `") == len(Cause) - 1


def test_each_checker_has_one_version_and_the_tests_do_not_need_it() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    dev = {re.split(r"[\[=<>~!]", one)[0]: one for one in project["optional-dependencies"]["dev"]}
    for name in "ruff", "pyright", "import-linter":
        assert re.search(r"[=~]=\d+\.\d+\.?\d*$", dev[name]), dev[name]
    rules = re.findall(r"^([\w-]+):.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.M)
    calls = {name: re.findall(r"ruff|pyright|lint-imports", body) for name, body in rules}
    assert set(calls["check"]) == {"ruff", "pyright", "lint-imports"} and calls["test"] == []


def test_the_set_up_commands_are_targets_of_the_makefile_and_ci_calls_the_test_command() -> None:
    assert set(COMMANDS) >= SET_UP_COMMANDS
    targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.M)
    assert {command.split()[1] for command in SET_UP_COMMANDS} <= set(targets)
    lines = re.findall(r"^make (.+)", (ROOT / ".ci/run").read_text(), re.M)
    called = [word for line in lines for word in line.split() if re.fullmatch(r"[\w-]*\w", word)]
    called = [word for word in called if not word.startswith("--")]
    assert called == ["kernels", "peers", "check", "test", "test-all"]


def test_the_page_of_the_paper_names_every_experiment() -> None:
    text = (ROOT / "docs/paper.md").read_text()
    section = text.split("`--only` takes one experiment:")[1].split("Each is one module")[0]
    assert re.findall(r"`([a-z0-9-]+)`", section) == list(claim_table().experiment)


def is_in_wall_time(command: str) -> bool:
    return shlex.split(command)[1] == "live"


FIRST, *OTHERS = (one for one in COMMANDS if one not in SET_UP_COMMANDS)


SHORTER_OPTIONS = {
    "--count 200": "--count 4",
    "--duration 20": "--duration 9",
    "occlusion:at=3": "occlusion:at=2",
    "relocate:at=5": "relocate:at=3",
    "--duration 8": "--duration 5",
    "--duration 6": "--duration 4",
}
"""Values of the pages that take long, and those of the tests."""


def list_words(command: str, folder: Path) -> list[str]:
    """Return the words of a command of rcmservo, with less to simulate.

    All but the first command and those with a rig of their own have small images.
    """
    is_first = command == FIRST
    longer = re.compile("|".join(map(re.escape, SHORTER_OPTIONS)))
    command = longer.sub(lambda option: SHORTER_OPTIONS[option[0]], command)
    program, *words = shlex.split(command)
    assert program == ".venv/bin/rcmservo"
    if words[0] == "study":
        return [*words, "--workers", "1"]
    if words[0] in ("run", "live"):
        words += ["--teaching-frames", "30"]
        if not is_first and "--rig" not in words:
            (folder / "small.toml").write_text(SMALL_RIG_TOML)
            words += ["--rig", str(folder / "small.toml")]
    return words


def test_the_pages_have_the_options_that_tests_shorten() -> None:
    assert [option for option in SHORTER_OPTIONS if option not in " ".join(COMMANDS)] == []


class InProcessPool:
    """Pool of one worker that runs every request in this process."""

    count, where = 1, "this process"

    def run(self, requests: Iterable[tuple[str, Any]]) -> Iterator[tuple[str, Any]]:
        for key, request in requests:
            yield key, run_chunk(request)


@pytest.fixture
def studies_in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the workers of studies, which take seconds to start, by this process."""
    pool = nullcontext(InProcessPool())
    monkeypatch.setattr(workers, "open_worker_pool", lambda *_: pool)


@pytest.mark.slow
@pytest.mark.usefixtures("studies_in_this_process", "blank_figures")
@pytest.mark.parametrize("command", [one for one in OTHERS if not is_in_wall_time(one)])
def test_every_other_command_of_the_first_pages_runs(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The commands run in this process, because a new one takes seconds to start."""
    monkeypatch.chdir(ROOT)
    assert main([*list_words(command, tmp_path), "--out", str(tmp_path / "out")]) == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [FIRST, *(pytest.param(x, marks=pytest.mark.alone) for x in OTHERS if is_in_wall_time(x))],
)
def test_the_script_runs_the_first_command_and_those_in_wall_time(
    command: str, tmp_path: Path
) -> None:
    words = list_words(command, tmp_path)
    script, folders = Path(sys.executable).with_name("rcmservo"), map(tmp_path.joinpath, "abcdef")

    def attempt() -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [script, *words, "--out", str(next(folders))],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
        )

    ran = retry_after_stalls if is_in_wall_time(command) else lambda run, _: run()
    done = ran(attempt, lambda run: run.returncode == 0)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_the_hello_example_reaches_its_target(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    program = (ROOT / "examples/01_hello.py").read_text()
    for long, short in {"rig.teach()": "rig.teach(frames=30)", "=8.0)": "=4.0)"}.items():
        assert program.count(long) == 1
        program = program.replace(long, short)
    (tmp_path / "hello.py").write_text(program)
    runpy.run_path(str(tmp_path / "hello.py"))
    phase, s, r, d = re.match(
        r"(\w+): Δs = (\S+) rad, Δr = (\S+) px, Δd = (\S+) px", capsys.readouterr().out
    ).groups()  # type: ignore[union-attr]
    assert phase == "servoing"
    assert abs(float(s)) < 0.009
    assert max(abs(float(r)), abs(float(d))) < 1.0


def test_citation_and_package_agree_on_the_version() -> None:
    import rcmservo

    assert f"version: {rcmservo.__version__}\n" in (ROOT / "CITATION.cff").read_text()
    assert f'version = "{rcmservo.__version__}"' in (ROOT / "pyproject.toml").read_text()


STUDIES = (ROOT / "docs/studies.md").read_text()


@pytest.mark.slow
@pytest.mark.usefixtures("studies_in_this_process", "blank_figures")
def test_the_estimator_of_the_studies_page_is_compared_as_described(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    block = re.search(r"```python\n(.*?)```", STUDIES, re.S)
    command = re.search(r"^rcmservo (study .*mylab:RLS.*)$", STUDIES, re.M)
    assert block is not None and command is not None
    code = [line for line in block[1].splitlines() if line and not line.startswith(("from", "im"))]
    assert len(code) <= 24, "twenty lines will do"
    (tmp_path / "mylab.py").write_text(block[1])
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    words = shlex.split(command[1].replace("--count 200", "--count 2"))
    assert main([*words, "--duration", "3", "--workers", "1"]) == 0
    output = capsys.readouterr().out
    assert "mylab:RLS compared with dlt" in output and (tmp_path / "runs/mine/report.html").exists()


def test_the_columns_of_the_studies_page_are_those_of_the_rows() -> None:
    from rcmservo.study.row import COLUMN_MEANINGS

    rows = dict(re.findall(r"^\| `(\w+)` \| (.*) \|$", STUDIES, re.M))
    assert {name: rows.get(name) for name in COLUMN_MEANINGS} == COLUMN_MEANINGS


@pytest.mark.parametrize(
    "block", re.findall(r"```toml\n(.*?)```", STUDIES, re.S), ids=("study", "search")
)
def test_the_files_of_the_studies_page_are_files_of_studies(block: str, tmp_path: Path) -> None:
    from rcmservo.study.plan.file import make_plan, read_study_file

    (tmp_path / "study.toml").write_text(block)
    plan = make_plan(read_study_file(tmp_path / "study.toml"), {})
    assert plan.cells and plan.runs >= 200
