"""Comparison of the servo's decisions with recorded ones, as a regression test.

    python benchmarks/decisions.py                   compare with all runs in tests/data
    python benchmarks/decisions.py FOLDER            compare with each FOLDER/NNN.npz
    python benchmarks/decisions.py FOLDER --keep N   first record the decisions of N runs
    python benchmarks/decisions.py FOLDER --anew     first record the present runs again

A file holds one run with the faults of `campaign.py` (point camera, 0.1 px) as plain arrays: the
observation and the decision of each tick. Some are in tests/data/decisions; tests/data/loops holds
those of record_loops.py. A commit that changes decisions on purpose records them again and states
the reason.
"""

import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import packed_table
from packed_table import Table

import rcmservo as rs
from rcmservo.config.class_registry import ESTIMATORS
from rcmservo.interfaces import DropReason

FOLDERS = [Path(__file__).parents[1] / "tests/data" / name for name in ("decisions", "loops")]

ROUNDING = 1e-8
"""Largest difference (rad/s or mm/s) of a command; rounding depends on the machine."""


@dataclass
class Compared:
    """Comparison of one run.

    ``differs`` is the first tick at which phase or cause differ, or the command by more than
    `ROUNDING`.
    """

    name: str
    ticks: int
    differs: int | None
    worst: float
    """Largest difference of a joint rate, rad/s or mm/s."""


def observations(table: Table) -> Iterator[rs.Observation]:
    """Yield the recorded observations."""
    rows = zip(table["integers"].tolist(), table["flags"], table["reals"], strict=True)
    for (whole, flags, r), words in zip(rows, table["words"], strict=True):
        now, q_time, frame, exposure, arrival = whole
        yield rs.Observation(
            now=now,
            q=r[0:3].copy(),
            q_time=q_time,
            enabled=bool(flags[0]),
            applied=r[3:6].copy(),
            frame=frame,
            exposure=exposure,
            arrival=arrival,
            q_exposure=r[6:9].copy(),
            points=r[9:13].copy().reshape(2, 2),
            drop_reason=DropReason[words[0]],
            recorded=bool(flags[1]),
            sizes=r[13:15].copy() if len(r) > 13 else np.full(2, np.nan),
        )


def servo_of(table: Table) -> rs.Servo:
    """Return the servo of a table: the default one, or with its estimator and features."""
    chosen: dict[str, Any] = {}
    if "estimator" in table:
        chosen["estimator"] = ESTIMATORS[str(table["estimator"])]()
        chosen["controller"] = rs.SaturatedController(features=str(table["features"]))
    return rs.Servo(rs.SphericalRcm(), rs.RigidTool(spacing=30.0), **chosen)


def targets(table: Table) -> Iterator[rs.Target]:
    """Yield the target of each stage."""
    points, q, shown = (table[f"target_{name}"] for name in ("points", "q", "shown"))
    sizes = table.get("target_sizes", np.full((len(q), 2), np.nan))
    for one in zip(points, q, shown, sizes, strict=True):
        yield rs.Target(one[0].copy(), one[1].copy(), int(one[2]), one[3].copy())


def decided(table: Table) -> Iterator[rs.State]:
    """Yield the states that the present servo computes from the recorded observations."""
    servo = servo_of(table)
    stages = zip(table["first"].tolist(), table["again"], targets(table), strict=True)
    begins = {first: (again, target) for first, again, target in stages}
    state, target = servo.init(), None
    for i, seen in enumerate(observations(table)):
        if i in begins:
            again, target = begins[i]
            state = servo.restart(state) if again else servo.init()
        assert target is not None
        state = servo.step(state, seen, target, rs.Request[table["words"][i, 1]])
        yield state


def read(path: Path) -> Table:
    """Return the table of a recorded run."""
    if path.suffix == ".xz":
        return packed_table.read(path)
    with np.load(path) as file:
        return dict(file)


def compared(path: Path) -> Compared:
    """Compare one recorded run with the present servo."""
    table = read(path)
    differs, worst = None, 0.0
    for i, state in enumerate(decided(table)):
        off = float(np.abs(state.command.rates - table["rates"][i]).max())
        same = (state.phase.name, state.cause.name) == tuple(table["words"][i, 2:])
        differs = i if differs is None and not (same and off <= ROUNDING) else differs
        worst = max(worst, off)
    return Compared(path.stem, len(table["rates"]), differs, worst)


def record_run(folder: Path, seed: int) -> None:
    """Record the run of the campaign with this seed."""
    import campaign

    from rcmservo.tracking import PointMarkers

    disturbances = campaign.disturbances_of(seed, "faults")
    settings = rs.sim.RigSettings(point_noise=0.1)
    rig = rs.sim.Rig(seed, settings, pictures=False, disturbances=disturbances)
    servo = rs.Servo(settings.mechanism, settings.tool)
    plant = rs.Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    run = recorded(rig, plant, servo, campaign.DURATION, campaign.PATIENCE)
    np.savez_compressed(folder / f"{seed:03d}.npz", **run)


def recorded(
    rig: rs.sim.Rig, plant: rs.Plant, servo: rs.Servo, duration: float, patience: int
) -> Table:
    """Teach the target, and run with an operator who acts up to `patience` times."""
    from rcmservo.loop.plant import NotEnabled
    from rcmservo.sim import Killed
    from rcmservo.sim.scripted_operator import ScriptedOperator, run_attended

    plant.recorded = lambda: not rig.disk_full()
    rig.move_to_target()
    target = rs.teach(plant, frames=30)
    rig.go_home()
    rig.begin()
    stages: list[tuple[int, bool, rs.Target]] = []
    ticks: list[rs.Tick] = []

    def begun(target: rs.Target, state: rs.State | None) -> None:
        stages.append((len(ticks), state is not None, target))

    operator = ScriptedOperator(rig, plant, patience, frames=30)
    with suppress(Killed, NotEnabled):
        for tick in run_attended(rig, plant, servo, target, duration, operator, begun):
            ticks.append(tick)
    return arrays(ticks, stages)


def arrays(ticks: list[rs.Tick], stages: list[tuple[int, bool, rs.Target]]) -> Table:
    """Return a run as plain arrays."""
    seen = [tick.observation for tick in ticks]
    words = [
        (t.observation.drop_reason.name, t.request.name, t.state.phase.name, t.state.cause.name)
        for t in ticks
    ]
    return {
        "integers": np.array([(o.now, o.q_time, o.frame, o.exposure, o.arrival) for o in seen]),
        "flags": np.array([(o.enabled, o.recorded) for o in seen]),
        "reals": np.array(
            [
                np.concatenate([o.q, o.applied, o.q_exposure, o.points.ravel(), o.sizes])
                for o in seen
            ]
        ),
        "rates": np.array([tick.state.command.rates for tick in ticks]),
        "words": np.array(words),
        "first": np.array([first for first, _, _ in stages]),
        "again": np.array([again for _, again, _ in stages]),
        "target_points": np.array([target.points for _, _, target in stages]),
        "target_q": np.array([target.q for _, _, target in stages]),
        "target_shown": np.array([target.taught_at for _, _, target in stages]),
        "target_sizes": np.array([target.sizes for _, _, target in stages]),
    }


def requested_seeds(folder: Path) -> list[int]:
    """Return the seeds of the runs to record first."""
    if "--keep" in sys.argv:
        return list(range(int(sys.argv[sys.argv.index("--keep") + 1])))
    return [int(path.stem) for path in folder.glob("*.npz")] if "--anew" in sys.argv else []


def main() -> None:
    folders = [Path(sys.argv[1])] if len(sys.argv) > 1 else FOLDERS
    with ProcessPoolExecutor() as pool:
        seeds = requested_seeds(folders[0])
        folders[0].mkdir(parents=True, exist_ok=True)
        list(pool.map(record_run, folders[:1] * len(seeds), seeds))
        paths = [path for folder in folders for path in sorted(folder.glob("*.npz*"))]
        runs = list(pool.map(compared, paths))
    other = [run for run in runs if run.differs is not None]
    worst = max((run.worst for run in runs), default=np.nan)
    print(f"{len(runs)} runs, {sum(run.ticks for run in runs)} ticks: {len(other)} runs differ")
    print(f"largest difference of a joint rate: {worst:.3g}")
    for run in other:
        print(f"  run {run.name} from tick {run.differs} on, by {run.worst:.3g}")
    sys.exit(bool(other) or not runs)


if __name__ == "__main__":
    main()
