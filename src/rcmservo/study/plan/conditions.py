"""Conditions of a study, which its plan, its file and the options of `rcmservo study` share."""

from dataclasses import dataclass
from typing import Annotated

from rcmservo.constraints import Checked, Limit, between, each, one_of
from rcmservo.loop.target_frames import FRAMES, TEACHING_FRAMES

COMPILED, MUJOCO, PICTURES = "compiled", "mujoco", "pictures"
ENGINES = COMPILED, MUJOCO, PICTURES
"""The compiled twin; MuJoCo's arm with the live path's own code; the same with rendered frames."""
AUTO = "auto"
"""The compiled engine where it can make the runs, else MuJoCo's."""
LONGEST = 3600.0
"""s of a closed loop."""
MOST = 100_000_000
"""Runs of a study."""

NOISE = each(between(0.0, 1000.0), "a number of px that is not negative, up to 1000")
LATENCY = each(between(0.0, 0.5), "a time from 0 to 0.5 s")
DURATION = Limit(lambda s: 1.0 < s <= LONGEST, f"more than 1 and at most {LONGEST:g} s")


SEED = Limit(lambda n: 0 <= n < 2**53, f"a whole number from 0 to {2**53 - 1}")


@dataclass(frozen=True, kw_only=True)
class RunConditions(Checked):
    """Conditions that an option of `rcmservo study` sets as a file does.

    Parameters
    ----------
    count : int
        Scenes of each kind.
    noise : tuple[float, ...]
        px of the camera that measures points; several are tried one after the other: write FILE
        before this option. By default that of the scenes.
    latency : tuple[float, ...]
        s from a frame's exposure to its arrival; several are tried one after the other: write FILE
        before this option. By default that of the scenes.
    repetitions : int
        Runs in each scene, with different noise.
    duration : float
        Length of each run, s.
    shown : int
        Frames that the target is shown for: 300 are 5 s.
    engine : str
        auto, which is the compiled twin where it can do it, else MuJoCo; or compiled, mujoco, or
        pictures, which is MuJoCo with rendered frames.
    """

    count: Annotated[int, between(1, MOST, "a whole number")] = 200
    noise: Annotated[tuple[float, ...], NOISE] = ()
    latency: Annotated[tuple[float, ...], LATENCY] = ()
    repetitions: Annotated[int, between(1, 1000, "a whole number")] = 1
    duration: Annotated[float, DURATION] = 15.0
    shown: Annotated[int, FRAMES] = TEACHING_FRAMES
    engine: Annotated[str, one_of((AUTO, *ENGINES))] = AUTO


@dataclass(frozen=True, kw_only=True)
class StudyConditions(RunConditions):
    """Conditions of every run of a study.

    Parameters
    ----------
    first_seed : int
        Of the first scene; the others follow one by one.
    disturb : tuple[tuple[str, ...], ...]
        What goes wrong, one set after the other.
    """

    first_seed: Annotated[int, SEED] = 0
    disturb: tuple[tuple[str, ...], ...] = ((),)
