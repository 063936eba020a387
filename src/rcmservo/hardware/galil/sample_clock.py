"""Conversion of a controller's sample counter to this computer's clock.

A data record carries the number of the sample at which the controller read the joints. The sample
lies between the request and the reply, but a delayed reply leaves its time uncertain. The
controller samples at an even rate, so the exchanges with the shortest round trip determine the time
of all samples. With the sample time (sample number times period), the offset between the clocks has
two bounds:

    largest offset     minimum of (received - sample time): no sample was read later
    smallest offset    maximum of (requested - period - sample time): no sample was read earlier,
                       except for the sample under way

Both bounds widen with time by ``MAX_CLOCK_DRIFT``. An exchange that contradicts them (after a reset
of the controller) restarts the estimate.
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
        self._sample_count, self._last_received = 0, 0.0
        self._min_offset = self._max_offset = 0.0
        self._has_started = False

    def time_of(self, sample: int, requested: float, received: float) -> float:
        """Return the time (s) of a sample from a reply between `requested` and `received`.

        The result is never later than `received`.
        """
        sample_count = self._unwrap(sample, received)
        sample_time = sample_count * self.period
        min_offset, max_offset = requested - self.period - sample_time, received - sample_time
        if self._has_started:
            drift = MAX_CLOCK_DRIFT * max(received - self._last_received, 0.0)
            min_bound = max(min_offset, self._min_offset - drift)
            max_bound = min(max_offset, self._max_offset + drift)
            if min_bound <= max_bound:
                min_offset, max_offset = min_bound, max_bound
        self._sample_count, self._last_received, self._has_started = sample_count, received, True
        self._min_offset, self._max_offset = min_offset, max_offset
        return min(sample_time + 0.5 * (min_offset + max_offset), received)

    def _unwrap(self, sample: int, received: float) -> int:
        """Return the total sample count, from the counter and the time since the last exchange."""
        if not self._has_started:
            return sample
        expected = self._sample_count + round((received - self._last_received) / self.period)
        half = COUNTER_MODULUS // 2
        return expected + (sample - expected + half) % COUNTER_MODULUS - half
