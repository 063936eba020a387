"""Conversion of a controller's sample counter to this computer's clock.

A data record carries the number of the controller's sample. The sample lies between the request and
the reply, but a delayed reply says little about when the joints were read. The controller samples
at an even rate, so the exchanges with the shortest round trip determine the time of all samples:

    latest     minimum of (received - sample time): no sample was read later
    earliest   maximum of (requested - sample time): no sample was read earlier, except for the
               sample under way

The offset between the clocks lies between these bounds. Both bounds widen with time by
``MAX_CLOCK_DRIFT``. An exchange that contradicts them (after a reset of the controller) restarts
the estimate.
"""

MAX_CLOCK_DRIFT = 300e-6
"""Largest relative drift between the clocks: 100 ppm for each, and a margin."""

SAMPLE_TIME_PER_TM_S = 0.9765625e-6
"""Sample time in s per unit of TM: TM 1000 gives 976.5625 us."""

COUNTER_MODULUS = 1 << 16
"""Samples after which the record's counter wraps, about a minute."""


class SampleClock:
    """Offset of a controller's sample counter from this computer's clock, updated per exchange.

    Parameters
    ----------
    period : float
        Sample time of the controller in s.
    """

    def __init__(self, period: float) -> None:
        self.period = period
        self._count, self._received = 0, 0.0
        self._earliest = self._latest = 0.0
        self._started = False

    def time_of(self, sample: int, requested: float, received: float) -> float:
        """Return the time (s) of a sample from a reply between `requested` and `received`.

        The result is never later than `received`.
        """
        count = self._unwrap(sample, received)
        sample_time = count * self.period
        earliest, latest = requested - self.period - sample_time, received - sample_time
        if self._started:
            drift = MAX_CLOCK_DRIFT * max(received - self._received, 0.0)
            earliest = max(earliest, self._earliest - drift)
            latest = min(latest, self._latest + drift)
        if earliest > latest:
            earliest, latest = requested - self.period - sample_time, received - sample_time
        self._count, self._received, self._started = count, received, True
        self._earliest, self._latest = earliest, latest
        return min(sample_time + 0.5 * (earliest + latest), received)

    def _unwrap(self, sample: int, received: float) -> int:
        """Return the total sample count, from the counter and the time since the last exchange."""
        if not self._started:
            return sample
        expected = self._count + round((received - self._received) / self.period)
        half = COUNTER_MODULUS // 2
        return expected + (sample - expected + half) % COUNTER_MODULUS - half
