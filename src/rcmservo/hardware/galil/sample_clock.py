"""When the controller read the joints, on this computer's clock.

A record tells the controller's sample, and came between asking and hearing: an answer that was held
up would give its joints a wrong time if that alone counted. But samples follow each other evenly.
So of all exchanges those count that took the least time there and back:

    latest     the least of (heard − sample): no sample was later than that
    earliest   the greatest of (asked − sample): none was earlier, but for the sample under way

Between the two lies the offset of the clocks. Both widen with time by DRIFT, by which the clocks
may run apart. What contradicts them (the controller was reset) begins anew.
"""

DRIFT = 300e-6
"""By which the clocks run apart at most: each by 100 ppm, and something to spare."""

MICROSECONDS = 0.9765625e-6
"""s of a sample for each of TM: TM 1000 is 976.5625 us."""

COUNTS = 1 << 16
"""Samples after which the record's counter begins anew, a minute."""


class SampleClock:
    """The offset of a controller's sample counter, learnt from exchange to exchange."""

    def __init__(self, period: float) -> None:
        self.period = period
        """s of a sample."""
        self._count, self._heard = 0, 0.0
        self._earliest = self._latest = 0.0
        self._begun = False

    def time_of(self, sample: int, asked: float, heard: float) -> float:
        """When a sample was, s, that came with an answer between `asked` and `heard`: never
        later."""
        count = self._unwrapped(sample, heard)
        here = count * self.period
        earliest, latest = asked - self.period - here, heard - here
        if self._begun:
            apart = DRIFT * max(heard - self._heard, 0.0)
            earliest = max(earliest, self._earliest - apart)
            latest = min(latest, self._latest + apart)
        if earliest > latest:
            earliest, latest = asked - self.period - here, heard - here
        self._count, self._heard, self._begun = count, heard, True
        self._earliest, self._latest = earliest, latest
        return min(here + 0.5 * (earliest + latest), heard)

    def _unwrapped(self, sample: int, heard: float) -> int:
        """The sample's number in all, by the time that has passed since the last."""
        passed = round((heard - self._heard) / self.period) if self._begun else 0
        expected = self._count + passed
        half = COUNTS // 2
        return expected + (sample - expected + half) % COUNTS - half if self._begun else sample
