"""Fuzzing of rig files and target files.

    python benchmarks/fuzz.py [--count N] [--seed SEED]

Half of the inputs are rig files, half are target files. Each starts as a valid file; some values
are replaced, and some files are damaged as text: flipped bits, cuts, repeated and exchanged lines,
odd tokens, deep nesting, other encodings. An input passes if it is rejected by an `RcmServoError`
with a one-line message, or accepted with the values that another parser reads. It fails with any
other exception, after 2 s, with other values, or beyond 256 MiB. Failed inputs are printed and
saved.
"""

import argparse
import json
import resource
import signal
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

import rcmservo as rs
from rcmservo.config import target_file
from rcmservo.config.class_registry import MECHANISMS
from rcmservo.config.rig_file import RigDescription, load_rig_file
from rcmservo.config.target_file import TargetSetup
from rcmservo.sim import Appearance, Drive, SceneSettings
from rcmservo.sim.rig_file import CameraSection, read_rig_settings
from rcmservo.tracking import COLOURS

ROOM = 256 * 2**20
PATIENCE = 2.0
LONGEST_MESSAGE = 1000
REFUSED, ACCEPTED = "refused", "accepted"

ODD_NUMBERS = (
    0,
    -1,
    1,
    2**31,
    2**63,
    -(2**64),
    10**400,
    1e-320,
    1e308,
    -1e308,
    -0.0,
    0.5,
    float("nan"),
    float("inf"),
    -float("inf"),
    640.0,
    1e-9,
    4097,
    63,
)
ODD_WORDS = (
    "",
    "red",
    "nan",
    "1.0",
    "\n",
    "\x1b[2J",
    "é" * 40,
    "\u2028",
    "x" * 5000,
    "../../etc",
    "true",
    "\x00",
    "'",
)
TOKENS = (
    b"nan",
    b"inf",
    b"-inf",
    b"NaN",
    b"Infinity",
    b"1e999",
    b"1e-999",
    b"9" * 5000,
    b"0x" + b"f" * 900,
    b"true",
    b"null",
    b"[[",
    b"]]",
    b"{",
    b"}",
    b"[" * 900,
    b'{"a":' * 900,
    b"a." * 450,
    b'"""',
    b"'''",
    b"\\u0000",
    b"\\ud800",
    b"\xff\xfe",
    b"\xef\xbb\xbf",
    b"\x00",
    b"\r",
    b"\n",
    b"=",
    b",",
    b":",
    b"#",
    b'"',
    b"_",
    b"1979-05-27T07:32:00Z",
    b" ",
)


@dataclass
class Campaign:
    """Numbers of outcomes, and failed inputs with their bytes."""

    counts: Counter[str]
    failures: list[tuple[str, bytes]]


def drawn(random: Random, value: Any) -> Any:
    """Return a random replacement of a value: near it, or of another size, type or shape."""
    if isinstance(value, list | tuple) and random.random() < 0.7:
        items = [drawn(random, item) if random.random() < 0.5 else item for item in value]
        return random.choice([items, items, items, items[1:], [*items, 1.0], items[::-1]])
    if isinstance(value, int | float) and not isinstance(value, bool) and random.random() < 0.6:
        return (
            value * random.choice([0.5, 0.9, 1.1, 2.0])
            if isinstance(value, float)
            else value + random.randint(-9, 9)
        )
    return random.choice(
        [
            random.choice(ODD_NUMBERS),
            random.choice(ODD_WORDS),
            random.choice(COLOURS),
            True,
            [],
            {},
            [1.0] * 3,
            {"a": 1},
            nested(random.randint(1, 90)),
            -1.0 if value is None else value,
        ]
    )


def nested(depth: int) -> Any:
    value: Any = 1.0
    for _ in range(depth):
        value = [value]
    return value


def disturbed(random: Random, table: dict[str, Any]) -> None:
    """Replace values, remove keys or rename them to unknown ones, in a table and its subtables."""
    for key in list(table):
        if isinstance(table[key], dict) and random.random() < 0.8:
            disturbed(random, table[key])
        elif random.random() < 0.08:
            table[key] = drawn(random, table[key])
        elif random.random() < 0.02:
            table[random.choice([key + "s", "", "a b", "\n", "kind", "x" * 300])] = table.pop(key)
        elif random.random() < 0.02:
            del table[key]


def damaged(random: Random, data: bytes) -> bytes:
    """Return the bytes with one to three random damages."""
    for _ in range(random.randint(1, 3)):
        data = random.choice(DAMAGES)(random, data)
    return data[:200_000]


def flipped(random: Random, data: bytes) -> bytes:
    place = random.randrange(max(len(data), 1))
    return (
        data[:place]
        + bytes(byte ^ 1 << random.randrange(8) for byte in data[place : place + 1])
        + data[place + 1 :]
    )


def cut(random: Random, data: bytes) -> bytes:
    return data[: random.randrange(len(data) + 1)]


def doubled(random: Random, data: bytes) -> bytes:
    lines = data.split(b"\n")
    lines.insert(random.randrange(len(lines) + 1), random.choice(lines))
    return b"\n".join(lines)


def shuffled(random: Random, data: bytes) -> bytes:
    lines = data.split(b"\n")
    i, j = random.randrange(len(lines)), random.randrange(len(lines))
    lines[i], lines[j] = lines[j], lines[i]
    return b"\n".join(lines)


def shortened(random: Random, data: bytes) -> bytes:
    start = random.randrange(len(data) + 1)
    return data[:start] + data[start + random.randint(1, 20) :]


def with_token(random: Random, data: bytes) -> bytes:
    place = random.randrange(len(data) + 1)
    return data[:place] + random.choice(TOKENS) + data[place + random.choice([0, 1, 4]) :]


def with_token_for_value(random: Random, data: bytes) -> bytes:
    """Return the bytes with a token instead of the value after an = or a colon."""
    places = [i + 1 for i, byte in enumerate(data) if byte in b"=:"]
    if not places:
        return data
    place = random.choice(places)
    end = data.find(b"\n", place)
    return data[:place] + random.choice(TOKENS) + (data[end:] if end >= 0 else b"")


def encoded(random: Random, data: bytes) -> bytes:
    return data.decode(errors="replace").encode(
        random.choice(["utf-16", "utf-32", "utf-8-sig", "latin-1"]), "replace"
    )


def swollen(random: Random, data: bytes) -> bytes:
    return data + random.choice(
        [b"\n" * 70_000, b" " * 60_000, b"#" + b"x" * 60_000, b"\n[a]" * 9000, b"[" * 60_000]
    )


DAMAGES: tuple[Callable[[Random, bytes], bytes], ...] = (
    flipped,
    flipped,
    cut,
    doubled,
    shuffled,
    shortened,
    with_token,
    with_token_for_value,
    encoded,
    swollen,
)


def toml(value: Any) -> str:
    """Return a value in TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value).replace("\x7f", "\\u007f")
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, dict):
        return (
            "{"
            + ", ".join(f"{json.dumps(key)} = {toml(item)}" for key, item in value.items())
            + "}"
        )
    return repr(value)


def rig_tables() -> list[dict[str, Any]]:
    """Return the tables of rig files with all keys of all sections at their defaults."""
    simulated = {
        "camera": asdict(CameraSection()),
        "drive": asdict(Drive()),
        "scene": asdict(SceneSettings()),
    }
    look = {
        key: value for key, value in asdict(Appearance()).items() if not key.startswith("marker_")
    }
    both = {**simulated, "appearance": look}
    tools = (
        {"kind": "rigid", "spacing": 30.0, "offset": 0.0},
        {"kind": "scaled", "scale": 1.3, "offset": 1.0},
    )
    tables: list[dict[str, Any]] = []
    for kind, cls in MECHANISMS.items():
        limits = asdict(cls().limits)  # pyright: ignore[reportCallIssue]
        for tool in tools:
            robot = {"mechanism": {"kind": kind, "insertion_zero": 0.0, **limits}, "tool": tool}
            lab = RigDescription()
            rest = {
                "markers": asdict(lab.markers),
                "gate": asdict(lab.gate),
                "thresholds": asdict(lab.thresholds),
            }
            tables.append(json.loads(json.dumps({**robot, **rest, **both})))
    return tables


RIGS = rig_tables()


def rig_file(random: Random) -> bytes:
    """Return a random rig file, valid or not."""
    tables = json.loads(json.dumps(random.choice(RIGS)))
    for name in list(tables):
        if random.random() < 0.4:
            del tables[name]
    if random.random() < 0.7:
        disturbed(random, tables)
    text: list[str] = []
    for name, table in tables.items():
        if isinstance(table, dict):
            text.append(f"[{name if name.isalpha() else json.dumps(name)}]")
            text += [
                f"{key if key.isidentifier() else json.dumps(key)} = {toml(value)}"
                for key, value in table.items()
                if value is not None
            ]
        else:
            text.insert(0, f"{json.dumps(name)} = {toml(table)}")
    data = "\n".join(text).encode(errors="replace")
    return damaged(random, data) if random.random() < 0.6 else data


def try_rig(path: Path) -> None:
    """Read a rig file; raise `AssertionError` if the result differs from the file."""
    lab = load_rig_file(path)
    settings = read_rig_settings(lab)
    tables = tomllib.loads(path.read_bytes().decode())
    for name in lab.devices:
        assert lab.devices[name] == tables.pop(name), f"the device [{name}] differs from the file"
    mechanism = {"kind": lab.mechanism.name, "insertion_zero": lab.mechanism.insertion_zero}
    timing = settings.timing
    camera = {
        "width": settings.width,
        "height": settings.height,
        "frame_rate": timing.frame_rate,
        "exposure": timing.exposure,
        "delay": timing.delay,
        "point_noise": settings.point_noise,
    }
    got = {
        "mechanism": {**mechanism, **asdict(lab.mechanism.limits)},
        "tool": {"kind": lab.tool.name, **asdict(lab.tool)},  # pyright: ignore[reportArgumentType]
        "markers": asdict(lab.markers),
        "gate": asdict(lab.gate),
        "thresholds": asdict(lab.thresholds),
        "camera": camera,
        "drive": asdict(settings.drive),
        "appearance": asdict(settings.appearance),
        "scene": asdict(settings.scene),
    }
    usual = {"mechanism": asdict(MECHANISMS[lab.mechanism.name]().limits), **DEFAULTS}  # pyright: ignore[reportCallIssue]
    assert set(tables) <= set(got), "a section was ignored"
    for name, fields in got.items():
        table = tables.get(name, {})
        assert set(table) <= set(fields), f"a key of [{name}] was ignored"
        for key, value in table.items():
            assert plain(fields[key]) == plain(value), (
                f"{name}.{key} is {fields[key]!r} instead of {value!r}"
            )
        for key in set(usual.get(name, {})) - set(table):
            assert plain(fields[key]) == plain(usual[name][key]), (
                f"{name}.{key} does not have its default"
            )


DEFAULTS: dict[str, Any] = {
    "markers": asdict(RigDescription().markers),
    "gate": asdict(RigDescription().gate),
    "thresholds": asdict(RigDescription().thresholds),
    "camera": asdict(CameraSection()),
    "drive": asdict(Drive()),
    "look": {
        key: value for key, value in asdict(Appearance()).items() if not key.startswith("marker_")
    },
    "scene": asdict(SceneSettings()),
}


def plain(value: Any) -> Any:
    """Return a value in a form for comparison: numbers as floats, lists as tuples.

    Booleans are not numbers.
    """
    if isinstance(value, list | tuple):
        return tuple(map(plain, value))
    if isinstance(value, bool) or not isinstance(value, int | float):
        return (type(value).__name__, value)
    return float(value)


SETUP = TargetSetup(
    "one camera", 640, 480, rs.SphericalRcm(), rs.RigidTool(spacing=30.0), RigDescription().markers
)


def target_content(folder: Path) -> dict[str, Any]:
    """Return the content of a valid target file."""
    points, q = np.array([[100.25, 50.125], [200.1, 300.3]]), np.array([0.7, 0.1, 120.0])
    target_file.save_target(folder / "good.json", rs.Target(points, q), SETUP)
    return json.loads((folder / "good.json").read_text())


def drawn_target(random: Random, content: dict[str, Any]) -> bytes:
    """Return a random target file, valid or not, often with a matching checksum."""
    content = json.loads(json.dumps(content))
    content["markers_px"] = [
        [random.uniform(-2.0, 642.0), random.uniform(-2.0, 482.0)] for _ in range(2)
    ]
    content["joints"] = [
        random.uniform(0.1, 1.5),
        random.uniform(-3.2, 3.2),
        random.uniform(38.0, 222.0),
    ]
    if random.random() < 0.6:
        disturbed(random, content)
    if random.random() < 0.8:
        content.pop("sha256", None)
        try:
            content["sha256"] = target_file.compute_checksum(content)
        except ValueError:
            content["sha256"] = "0" * 64
    items = list(content.items())
    random.shuffle(items)
    data = json.dumps(dict(items), indent=random.choice([None, 1])).encode(errors="replace")
    return damaged(random, data) if random.random() < 0.6 else data


def try_target(path: Path) -> None:
    """Read a target file; raise `AssertionError` if the result is incorrect or unexpected."""
    target = target_file.load_target(path, SETUP)
    content = json.loads(path.read_bytes())
    assert target.points.tolist() == content["markers_px"]
    assert target.q.tolist() == content["joints"]
    assert (np.abs(target.points - [319.5, 239.5]) <= [320.0, 240.0]).all(), (
        "a marker is outside the picture"
    )
    assert ((target.q >= [0.13, -3.18, 39.0]) & (target.q <= [1.491, 3.18, 221.0])).all(), (
        "a joint is beyond its limits"
    )
    assert content["setup"] == json.loads((path.parent / "good.json").read_text())["setup"]
    assert content.pop("sha256") == target_file.compute_checksum(content)


class Hung(BaseException):
    """Raised if an input takes longer than `PATIENCE`."""


def outcome(attempt: Callable[[Path], None], path: Path) -> tuple[str, str]:
    """Return the outcome of an input, and the error if it failed."""
    try:
        attempt(path)
    except rs.RcmServoError as error:
        words = str(error)
        one = words.isprintable() and len(words) < LONGEST_MESSAGE
        return REFUSED, "" if one else f"the message is not one readable line: {words[:300]!r}"
    except (Exception, Hung) as error:
        return "failed", f"{type(error).__name__}: {str(error)[:300]}"
    return ACCEPTED, ""


def campaign(count: int, seed: int) -> Campaign:
    """Try `count` random inputs; each depends on the seed and its number."""
    result = Campaign(Counter(), [])

    def hung(number: int, frame: object) -> None:
        raise Hung

    usual = signal.signal(signal.SIGALRM, hung)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        content = target_content(folder)
        for number in range(count):
            random = Random(f"{seed} {number}")
            kind = ("rig", "target")[number % 2]
            data = rig_file(random) if kind == "rig" else drawn_target(random, content)
            path = folder / "input"
            path.write_bytes(data)
            signal.setitimer(signal.ITIMER_REAL, PATIENCE)
            try:
                how, wrong = outcome(try_rig if kind == "rig" else try_target, path)
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0.0)
            result.counts[f"{kind} {how}"] += 1
            if wrong:
                result.failures.append((f"{kind} {number}: {wrong}", data))
    signal.signal(signal.SIGALRM, usual)
    return result


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=100_000, help="number of inputs")
    parser.add_argument("--seed", type=int, default=0, help="seed of the inputs")
    parser.add_argument(
        "--keep", type=Path, default=Path("runs/fuzz"), help="folder for failed inputs"
    )
    options = parser.parse_args()
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + ROOM, resource.RLIM_INFINITY))
    result = campaign(options.count, options.seed)
    for name, count in sorted(result.counts.items()):
        print(f"{name}: {count}")
    for number, (what, data) in enumerate(result.failures):
        options.keep.mkdir(parents=True, exist_ok=True)
        (options.keep / f"{number}").write_bytes(data)
        print(what)
    print(f"{len(result.failures)} of {options.count} inputs failed")
    return 1 if result.failures else 0


if __name__ == "__main__":
    sys.exit(main())
