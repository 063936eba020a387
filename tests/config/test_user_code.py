"""User-defined code runs only if the command line names it, or a rig file that names devices."""

import importlib
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import rcmservo as rs
from rcmservo.cli.cli import main
from rcmservo.config.user_estimators import hash_source, import_estimator
from rcmservo.recording.writer import Recorder

IMPORT_MODULE = importlib.import_module
MALICIOUS = "from pathlib import Path\nPath('imported').write_text('yes')\n"


@pytest.fixture
def working_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Change to a directory with a module that writes a file when it is imported."""
    (tmp_path / "malicious.py").write_text(MALICIOUS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    return tmp_path


def import_only_dependencies(name: str, package: str | None = None) -> ModuleType:
    """Import a module, except for one that an estimator's name in this file contains."""
    if name in ("os", "malicious", "subprocess"):
        pytest.fail(f"imports {name}")
    return IMPORT_MODULE(name, package)


def write_record_with_estimator(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Write a record whose estimator has a given name."""
    servo = rs.Servo(rs.SphericalRcm(), rs.RigidTool(spacing=30.0))
    with monkeypatch.context() as other:
        other.setattr("rcmservo.config.servo_json.find_class_name", lambda value, kinds: name)
        with Recorder(folder / "record.mcap", {}) as recorder:
            recorder.begin(servo, rs.Target(np.zeros((2, 2)), np.zeros(3)))


@pytest.mark.parametrize("name", ["os:system", "malicious:RLS", "malicious", "subprocess:Popen"])
@pytest.mark.parametrize("command", ["replay", "show", "export"])
def test_a_malicious_record_imports_nothing(
    name: str, command: str, working_directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_record_with_estimator(name, working_directory, monkeypatch)
    monkeypatch.setattr("importlib.import_module", import_only_dependencies)
    code = main([command, "record.mcap", *(["--out", "out"] if command != "replay" else [])])
    assert code == (2 if command == "replay" else 0)
    assert "malicious" not in sys.modules and not (working_directory / "imported").exists()


def test_only_the_code_that_the_command_line_names_is_imported(
    working_directory: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_record_with_estimator("malicious:RLS", working_directory, monkeypatch)
    (working_directory / "harmless.py").write_text(VALID_MODULE)
    assert main(["replay", "record.mcap", "--estimator", "harmless:Own"]) == 2
    assert "malicious:RLS" in capsys.readouterr().err
    assert "harmless" in sys.modules and "malicious" not in sys.modules


def test_a_malicious_rig_imports_nothing(
    working_directory: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (working_directory / "rig.toml").write_text('[estimator]\nkind = "malicious:RLS"\n')
    assert main(["run", "--rig", "rig.toml", "--out", "out"]) == 2
    (working_directory / "rig.toml").write_text('[tool]\nkind = "malicious:RLS"\n')
    assert main(["run", "--rig", "rig.toml", "--out", "out"]) == 2
    errors = capsys.readouterr().err.splitlines()
    assert "section estimator" in errors[0] and "tool.kind" in errors[1] and len(errors) == 2
    assert "malicious" not in sys.modules and not (working_directory / "imported").exists()


VALID_MODULE = """
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
        ("valid1:Half", "it lacks jacobian, update"),
        ("valid1:Alien", "derives from rcmservo.Estimator"),
        ("valid1:Missing", "derives from rcmservo.Estimator"),
        ("valid1:Needy", "it raised no"),
        ("nowhere1:RLS", "No module named 'nowhere1'"),
        ("valid1 :Own", "or module:class such as mylab.rls:RLS"),
        ("os;valid1:Own", "or module:class such as mylab.rls:RLS"),
        ("broken1:Own", "broken1 raised ZeroDivisionError('division by zero')"),
        ("leaves1:Own", "leaves1 raised SystemExit"),
    ],
)
def test_a_name_without_a_usable_estimator_is_refused_with_a_reason(
    name: str, sentence: str, working_directory: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (working_directory / "valid1.py").write_text(VALID_MODULE)
    (working_directory / "broken1.py").write_text("1 / 0\n")
    (working_directory / "leaves1.py").write_text("import sys\nsys.exit(0)\n")
    assert main(["run", "--estimator", name, "--out", "out"]) == 2
    error = capsys.readouterr().err
    assert "--estimator" in error and sentence in error and repr(name) in error
    assert len(error.splitlines()) == 1 and not (working_directory / "out").exists()


def test_a_module_in_the_current_directory_is_found_and_its_source_hashed(
    working_directory: Path,
) -> None:
    (working_directory / "valid2.py").write_text(VALID_MODULE)
    kind = import_estimator("valid2:Own")
    before = hash_source(kind())
    assert len(before) == 64 and before == hash_source(kind())
    (working_directory / "valid2.py").write_text(VALID_MODULE + "# another\n")
    assert hash_source(kind()) != before
    assert hash_source(rs.ProjectionEstimator()) == ""
