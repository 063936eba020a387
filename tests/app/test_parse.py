"""What is wrong with a command line is one sentence: option, value, what is right, where to read
more."""

import pytest

from rcmservo.app.cli import main

RUN = "; see rcmservo run --help"
SENTENCES = {
    "run --seed": "--seed must be given INT, got ''" + RUN,
    "run --seed abc": "--seed must be a whole number, got 'abc'" + RUN,
    "run --seed 1.5": "--seed must be a whole number, got '1.5'" + RUN,
    "run --duration x": "--duration must be a number, got 'x'" + RUN,
    "run --projection.observations 2.5": "--projection.observations must be a whole number, "
    "got '2.5'" + RUN,
    "run --controller.bounds 1 2": "--controller.bounds must be given FLOAT FLOAT FLOAT, "
    "got '1 2'" + RUN,
    "run --controller.bounds 1 2 x": "--controller.bounds must be given FLOAT FLOAT FLOAT, "
    "got '1 2 x'" + RUN,
    "run --controller.potential print": "--controller.potential must be one of continuous, "
    "printed, got 'print' (did you mean printed?)" + RUN,
    "run --controllr.gain 3": "run has no option --controllr.gain (did you mean "
    "--controller.gain?)" + RUN,
    "run --imaged_rcm.max-conditio 3": "run has no option --imaged_rcm.max-conditio (did you mean "
    "--imaged-rcm.max-condition?)" + RUN,
    "run x": "'x' is more than run takes" + RUN,
    "show a --seed 3": "show has no option --seed; see rcmservo show --help",
    "show": "PATH must be given: A run's folder, or an .mcap file; see rcmservo show --help",
    "rnu": "the command must be one of run, live, serve, replay, show, export, paper, study, "
    "tune, emulate, rig, markers, got 'rnu' (did you mean run?); see rcmservo --help",
    "": "a command must be given, one of run, live, serve, replay, show, export, paper, study, "
    "tune, emulate, rig, markers; see rcmservo --help",
}


@pytest.mark.parametrize("line", SENTENCES)
def test_a_line_that_cannot_be_read_is_one_sentence(
    line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(line.split()) == 2
    assert capsys.readouterr().err == f"rcmservo: {SENTENCES[line]}\n"


def test_what_the_settings_refuse_keeps_their_words_and_points_to_the_help(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["run", "--controller.gain", "-1"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("rcmservo: controller.gain must be ") and said.endswith(
        "got -1.0; see rcmservo run --help\n"
    )


@pytest.mark.parametrize(
    "option",
    [
        "projection.observations",
        "imaged-rcm.lines",
        "imaged-rcm.refinements",
        "exploration.legs",
        "resumes",
        "duration",
    ],
)
def test_a_size_that_no_computer_has_room_or_time_for_is_refused_at_once(
    option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", f"--{option}", "1000000000"]) == 2
    assert "1000000000" in capsys.readouterr().err


def test_help_tells_the_basics_before_the_settings(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["run", "--help"])
    said = capsys.readouterr().out
    assert not stop.value.code
    basics = [said.index(f"--{name}") for name in ("seed", "duration", "out", "json")]
    settings = [said.index(f"--{name}.") for name in ("controller", "exploration", "projection")]
    assert max(basics) < min(settings)
