"""The process is held up: it runs late, is stopped for a while, or is killed."""

from rcmservo.errors import RcmServoError
from rcmservo.sim.disturbances.schedule import Schedule


class Killed(RcmServoError):
    """The simulated process was killed: from here on nothing is sent, and the arm's own watchdog
    must stop it.

    `Rig.let_pass` lets time go on without the process.
    """


class Stalls:
    """Times at which waits really end."""

    def __init__(self, schedule: Schedule) -> None:
        self.schedule = schedule

    def __call__(self, time: int) -> int:
        """Return the time at which the process wakes that waits until `time` ns. A killed one never
        does."""
        for event in self.schedule.begun(time, "kill"):
            self.schedule.killed = True
            raise Killed(f"the process was killed {event.disturbance.at:g} s after the start")
        for event in self.schedule.acting(time, "jitter"):
            time += round(event.random.uniform(0.0, event.number("s")) * 1e9)
        for event in self.schedule.acting(time, "stall"):
            if event.word("where") == "between":
                time = max(time, round(event.end))
        return time
