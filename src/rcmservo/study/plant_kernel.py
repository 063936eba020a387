"""The twin of the simulated laboratory, for studies: arm and point camera as compiled functions.

The drives are those of `rcmservo.sim.arm`: delay, first-order lag, deadband, inertia, counting
encoders and hard stops. The camera is that of `rcmservo.sim.cameras`: the same lens, the same
times. With the same noise a closed loop goes the way that it goes in the laboratory, to a few
1e-6 mm. The inertia delays by less than a millisecond, but what a servo decides can hang on that:
without it one loop in seven ended more than 5 % nearer or farther off.
"""

import numpy as np
from numpy.typing import NDArray

from rcmservo.geometry.kinematics import Point
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import fill, put
from rcmservo.numerics.structs import Row, flag, part, real, reals, whole, wholes
from rcmservo.sim.camera_kernels import CameraStruct
from rcmservo.study.inertia import Inertia, Near, near

STEP = 1_000_000
"""ns of one step of the arm."""

PAST = 1024
"""Steps of the arm that are kept, and answers of it: as far back as a frame may be exposed."""

QUEUE = 128
"""Commands that may be on their way to the drives."""


class Pace(Row):
    """When the camera's frames are taken and arrive."""

    period: float = real("ns", "from frame to frame")
    late: int = whole("ns", "from a frame's exposure to its arrival")


class Drives(Row):
    """The arm, and what of its drives does not change."""

    time: int = whole("ns", "now")
    q: Floats = reals(3, "rad, rad, mm", "the joints as they are")
    speeds: Floats = reals(3, "rad/s, rad/s, mm/s", "their rates")
    rates: Floats = reals(3, "rad/s, rad/s, mm/s", "the rates that the drives pull to, lagging")
    wanted: Floats = reals(3, "rad/s, rad/s, mm/s", "the rates that the drives obey")
    applied: Floats = reals(3, "rad/s, rad/s, mm/s", "the rates last taken of a command")
    on: bool = flag("whether the drives are on")
    first: int = whole("", "the oldest command on its way")
    last: int = whole("", "the newest command on its way, and one more")
    delay: int = whole("ns", "from a command to its being obeyed")
    follow: float = real("", "share of the way to the wanted rate in one step")
    deadband: Floats = reals(3, "rad/s, rad/s, mm/s", "made rates below which it stays still")
    encoder: Floats = reals(3, "rad, rad, mm", "of one count")
    offset: Floats = reals(3, "rad, rad, mm", "by which what they tell is beside the joints")
    made: Floats = reals(3, "", "what each motor makes of its rate")
    lower: Floats = reals(3, "rad, rad, mm", "the hard stops")
    upper: Floats = reals(3, "rad, rad, mm", "the hard stops")
    inertia: Inertia = part(Inertia, "its masses")


class Twin(Row):
    """A laboratory that runs. It is one row, so that nothing counts who refers to its arrays."""

    drives: Drives = part(Drives, "the arm")
    queue: Floats = reals((QUEUE, 3), "rad/s, rad/s, mm/s", "rates on their way to the drives")
    due: NDArray[np.int64] = wholes(QUEUE, "ns", "when each is obeyed")
    past: Floats = reals((PAST, 3), "rad, rad, mm", "the joints at each of the last steps")
    told: Floats = reals((PAST, 3), "rad, rad, mm", "as the arm told them at the last ticks")
    lens: CameraStruct = part(CameraStruct, "the camera")
    pace: Pace = part(Pace, "its frames")


@compiled
def advance(twin: Twin, until: int) -> None:
    """Let time pass until a moment (ns), a tick later at most, to the nearest step."""
    a = twin.drives
    left = (until - a.time + STEP // 2 - 1) // STEP
    here = midway(a, left)
    while left > 0:
        if not a.on:
            a.first = a.last
            fill(a.wanted, 0.0)
            fill(a.rates, 0.0)
        while a.first < a.last and twin.due[a.first % QUEUE] <= a.time + STEP:
            obey(a, twin.queue[a.first % QUEUE])
            a.first += 1
        steps = left
        if a.first < a.last:
            steps = min(left, max((twin.due[a.first % QUEUE] - a.time - 1) // STEP, 1))
        move(a, here, twin.past, steps)
        a.time += steps * STEP
        left -= steps


@compiled
def midway(a: Drives, steps: int) -> Near:
    """The arm's equations about the middle of the way that it goes in so many steps."""
    half = 0.5 * steps * STEP * 1e-9
    inner = 1 - a.inertia.outer
    z, angle = a.q[2] + half * a.speeds[2], a.q[inner] + half * a.speeds[inner]
    return near(a.inertia, z, angle, STEP * 1e-9)


@compiled
def obey(a: Drives, rates: Floats) -> None:
    """Want what the motors make of these rates (3,)."""
    for i in range(3):
        a.wanted[i] = a.made[i] * rates[i]


@compiled
def move(a: Drives, here: Near, past: Floats, steps: int) -> None:
    """So many steps towards the rates that are wanted, by the equations `here`.

    Numbers one by one, of outer hinge, inner hinge and slide, stay in the processor's registers.
    """
    h, follow, o = STEP * 1e-9, a.follow, a.inertia.outer
    i, place = 1 - o, a.time // STEP
    (q_o, q_i, q_s), (v_o, v_i, v_s) = in_turn(a.q, o), in_turn(a.speeds, o)
    (r_o, r_i, r_s), (w_o, w_i, w_s) = in_turn(a.rates, o), in_turn(a.wanted, o)
    d_o, d_i, d_s = in_turn(a.deadband, o)
    (low_o, low_i, low_s), (high_o, high_i, high_s) = in_turn(a.lower, o), in_turn(a.upper, o)
    k_o, k_i, k_s = in_turn(a.inertia.strength, o)
    (by_o, by_i, by_s), (o_z, i_z), o_a = here.by, here.by_z, here.by_angle
    (c_a, c_b, c_e), (a_z, b_z, e_z), (a_a, b_a) = here.c, here.c_z, here.c_angle
    z, angle = q_s - here.z, q_i - here.angle
    by_o, by_i = by_o + o_z * z + o_a * angle, by_i + i_z * z
    c_a, c_b, c_e = c_a + a_z * z + a_a * angle, c_b + b_z * z + b_a * angle, c_e + e_z * z
    for _ in range(steps):
        turned = v_o * v_o
        c_o = (v_o + v_o) * (c_a * v_i + c_b * v_s)
        c_i = (v_s + v_s) * c_e * v_i - c_a * turned
        c_s = -(c_b * turned + c_e * v_i * v_i)
        r_o, r_i = r_o + follow * (w_o - r_o), r_i + follow * (w_i - r_i)
        r_s += follow * (w_s - r_s)
        v_o += by_o * (k_o * (beyond(r_o, d_o) - v_o) - c_o)
        v_i += by_i * (k_i * (beyond(r_i, d_i) - v_i) - c_i)
        v_s += by_s * (k_s * (beyond(r_s, d_s) - v_s) - c_s)
        gone_o, gone_i, gone_s = v_o * h, v_i * h, v_s * h
        by_o, by_i = by_o + o_z * gone_s + o_a * gone_i, by_i + i_z * gone_s
        c_a, c_b = c_a + a_z * gone_s + a_a * gone_i, c_b + b_z * gone_s + b_a * gone_i
        c_e += e_z * gone_s
        q_o, q_i = min(max(q_o + gone_o, low_o), high_o), min(max(q_i + gone_i, low_i), high_i)
        q_s = min(max(q_s + gone_s, low_s), high_s)
        place = (place + 1) & (PAST - 1)
        past[place, o], past[place, i], past[place, 2] = q_o, q_i, q_s
    a.q[o], a.q[i], a.q[2] = q_o, q_i, q_s
    a.speeds[o], a.speeds[i], a.speeds[2] = v_o, v_i, v_s
    a.rates[o], a.rates[i], a.rates[2] = r_o, r_i, r_s


@compiled
def beyond(rate: float, deadband: float) -> float:
    """The rate, or 0 within the deadband."""
    return rate if abs(rate) > deadband else 0.0


@compiled
def in_turn(values: Floats, outer: int) -> Point:
    """Of outer hinge, inner hinge and slide."""
    return values[outer], values[1 - outer], values[2]


@compiled
def place(twin: Twin, now: int) -> None:
    """The drives go on at `now` ns, with the tool at rest as if it had always been there."""
    a = twin.drives
    a.time, a.on = now, True
    for i in range(PAST):
        put(twin.past[i], a.q)


@compiled
def take(twin: Twin, rates: Floats, on: bool) -> None:
    """Take a command."""
    a = twin.drives
    a.on = a.on and on
    for i in range(3):
        a.applied[i] = rates[i] if a.on else 0.0
    put(twin.queue[a.last % QUEUE], a.applied)
    twin.due[a.last % QUEUE] = a.time + a.delay
    a.last += 1


@compiled
def between(earlier: Floats, later: Floats, share: float, into: Floats) -> None:
    """Write the joints (3,) a share of the way from one place to another."""
    for i in range(3):
        into[i] = earlier[i] + share * (later[i] - earlier[i])


@compiled
def joints_at(twin: Twin, time: int, into: Floats) -> None:
    """Write the joints (3,) as they were at a moment (ns) of the last second."""
    step = time // STEP
    share = (time - step * STEP) / STEP
    between(twin.past[step % PAST], twin.past[(step + 1) % PAST], share, into)


@compiled
def count(twin: Twin, into: Floats) -> None:
    """Write the joints (3,) as the encoders count them now."""
    a = twin.drives
    for i in range(3):
        into[i] = np.round((a.q[i] + a.offset[i]) / a.encoder[i]) * a.encoder[i]


@compiled
def newest(pace: Pace, now: int) -> int:
    """Number of the newest frame that has arrived, -1 before the first."""
    return max(int(np.floor((now - pace.late) / pace.period + 1e-6)), -1)
