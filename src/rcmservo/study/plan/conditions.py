"""Conditions of a study: settings that its plan, its file and the command-line options share."""

from dataclasses import dataclass
from typing import Annotated, Literal

from rcmservo.constraints import Checked, Limit, above, between, each, one_of
from rcmservo.loop.target_frames import FRAME_COUNT, TEACHING_FRAMES

ENGINES = COMPILED, MUJOCO, PICTURES = "compiled", "mujoco", "pictures"
"""Engines: the compiled plant, the full simulator with MuJoCo's arm and the code of the live loop,
and the full simulator with rendered frames."""
AUTO = "auto"
"""Choice of the compiled plant if it supports all runs of a study, else of the full simulator."""
MAX_DURATION_S = 3600.0
"""Largest length of a closed loop, s."""
MAX_RUNS = 100_000_000
"""Largest number of runs of a study."""

NOISE_LIMIT = each(between(0.0, 1000.0), "a number of px that is not negative, up to 1000")
LATENCY_LIMIT = each(between(0.0, 0.5), "a time from 0 to 0.5 s")
DURATION_LIMIT = above(1.0, MAX_DURATION_S, "a time", "s")
SEED_LIMIT = Limit(lambda n: 0 <= n < 2**53, f"a whole number from 0 to {2**53 - 1}")


@dataclass(frozen=True, kw_only=True)
class RunConditions(Checked):
    """Conditions that a study file and the options of `rcmservo study` both set.

    Parameters
    ----------
    count : int
        Number of scenes of each distribution.
    noise : tuple[float, ...]
        Noise of the camera that measures points, px; several values are studied one after the
        other: write FILE before this option. By default that of the scenes.
    latency : tuple[float, ...]
        Time from a frame's exposure to its arrival, s; several values are studied one after the
        other: write FILE before this option. By default that of the scenes.
    repetitions : int
        Number of runs in each scene, with different noise.
    arm : Literal['ideal', 'good', 'worn']
        Quality of the arm.
    duration : float
        Length of each run, s.
    teaching_frames : int
        Number of frames whose mean is the target: 300 frames last 5 s.
    engine : str
        auto: the compiled plant if it supports all runs, otherwise MuJoCo for all of them. Or
        compiled, mujoco, or pictures for MuJoCo with rendered frames.
    """

    count: Annotated[int, between(1, MAX_RUNS, "a whole number")] = 200
    noise: Annotated[tuple[float, ...], NOISE_LIMIT] = ()
    latency: Annotated[tuple[float, ...], LATENCY_LIMIT] = ()
    repetitions: Annotated[int, between(1, 1000, "a whole number")] = 1
    arm: Literal["ideal", "good", "worn"] = "ideal"
    duration: Annotated[float, DURATION_LIMIT] = 15.0
    teaching_frames: Annotated[int, FRAME_COUNT] = TEACHING_FRAMES
    engine: Annotated[str, one_of((AUTO, *ENGINES))] = AUTO


@dataclass(frozen=True, kw_only=True)
class StudyConditions(RunConditions):
    """Conditions of every run of a study.

    Parameters
    ----------
    first_seed : int
        Seed of the first scene; the others have consecutive seeds.
    disturb : tuple[tuple[str, ...], ...]
        Sets of disturbances, each a condition of its own.
    """

    first_seed: Annotated[int, SEED_LIMIT] = 0
    disturb: tuple[tuple[str, ...], ...] = ((),)
