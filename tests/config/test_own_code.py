"""Code of others runs when a person names it on the command line, and never because a rig or record
does.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

import rcmservo as rs
from rcmservo.cli.cli import main
from rcmservo.config.user_code import named, source
from rcmservo.recording.writer import Recorder

HOSTILE = "from pathlib import Path\nPath('imported').write_text('yes')\n"


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The present folder, with a module that leaves a trace when it is imported."""
    (tmp_path / "hostile.py").write_text(HOSTILE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    return tmp_path


def record_that_names(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A record whose estimator is called this."""
    servo = rs.Servo(rs.SphericalRcm(), rs.RigidTool(spacing=30.0))
    with monkeypatch.context() as other:
        other.setattr("rcmservo.config.servo_json.name_of", lambda value, kinds: name)
        with Recorder(folder / "record.mcap", {}) as recorder:
            recorder.begin(servo, rs.Target(np.zeros((2, 2)), np.zeros(3)))


@pytest.mark.parametrize("name", ["os:system", "hostile:RLS", "hostile", "subprocess:Popen"])
@pytest.mark.parametrize("command", ["replay", "show", "export"])
def test_a_hostile_record_imports_nothing(
    name: str, command: str, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record_that_names(name, here, monkeypatch)
    monkeypatch.setattr("importlib.import_module", lambda module: pytest.fail(f"imports {module}"))
    code = main([command, "record.mcap", *(["--out", "out"] if command != "replay" else [])])
    assert code == (2 if command == "replay" else 0)
    assert "hostile" not in sys.modules and not (here / "imported").exists()


def test_a_record_that_names_other_code_than_the_command_line_imports_only_that(
    here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    record_that_names("hostile:RLS", here, monkeypatch)
    (here / "harmless.py").write_text(GOOD)
    assert main(["replay", "record.mcap", "--estimator", "harmless:Own"]) == 2
    assert "hostile:RLS" in capsys.readouterr().err
    assert "harmless" in sys.modules and "hostile" not in sys.modules


def test_a_hostile_rig_imports_nothing(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "rig.toml").write_text('[estimator]\nkind = "hostile:RLS"\n')
    assert main(["run", "--rig", "rig.toml", "--out", "out"]) == 2
    (here / "rig.toml").write_text('[tool]\nkind = "hostile:RLS"\n')
    assert main(["run", "--rig", "rig.toml", "--out", "out"]) == 2
    told = capsys.readouterr().err.splitlines()
    assert "section estimator" in told[0] and "tool.kind" in told[1] and len(told) == 2
    assert "hostile" not in sys.modules and not (here / "imported").exists()


GOOD = """
from dataclasses import dataclass
import numpy as np
import rcmservo as rs

@dataclass(frozen=True)
class Own(rs.Estimator):
    gain: float = 1.0
    name = "own"
    def init(self): return np.zeros((3, 3))
    def update(self, memory, tool, sample): return memory
    def jacobian(self, memory, tool, sample): return memory

@dataclass(frozen=True)
class Half(rs.Estimator):
    def init(self): return None

class Plain(Own):
    pass

class Alien:
    pass

@dataclass(frozen=True)
class Needy(Own):
    def __post_init__(self): raise ZeroDivisionError("no")
"""


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("good1:Half", "it lacks jacobian, update"),
        ("good1:Alien", "derives from rcmservo.Estimator"),
        ("good1:Missing", "derives from rcmservo.Estimator"),
        ("good1:Needy", "to make one raised no"),
        ("nowhere1:RLS", "No module named 'nowhere1'"),
        ("good1 :Own", "or module:class such as mylab.rls:RLS"),
        ("os;good1:Own", "or module:class such as mylab.rls:RLS"),
        ("broken1:Own", "broken1 raised ZeroDivisionError('division by zero')"),
        ("leaves1:Own", "leaves1 raised SystemExit"),
    ],
)
def test_a_name_that_leads_to_no_estimator_is_refused_in_a_sentence(
    name: str, sentence: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "good1.py").write_text(GOOD)
    (here / "broken1.py").write_text("1 / 0\n")
    (here / "leaves1.py").write_text("import sys\nsys.exit(0)\n")
    assert main(["run", "--estimator", name, "--out", "out"]) == 2
    told = capsys.readouterr().err
    assert "--estimator" in told and sentence in told and repr(name) in told
    assert len(told.splitlines()) == 1 and not (here / "out").exists()


def test_a_module_is_found_in_the_present_folder_and_its_source_is_told_by_a_hash(
    here: Path,
) -> None:
    (here / "good2.py").write_text(GOOD)
    kind = named("good2:Own")
    before = source(kind())
    assert len(before) == 64 and before == source(kind())
    (here / "good2.py").write_text(GOOD + "# another\n")
    assert source(kind()) != before
    assert source(rs.ProjectionEstimator()) == ""
