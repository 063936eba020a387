"""A signal that asks a program to end in order."""

import os
import signal

import pytest

from rcmservo.errors import Stopped
from rcmservo.live.stop_signals import END_SIGNALS, stopped_by_signals


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_the_first_signal_stops_in_order_and_the_next_interrupts_nothing(
    number: signal.Signals,
) -> None:
    heard: list[int] = []
    usual = {
        one: signal.signal(one, lambda n, _: heard.append(n)) for one in {*END_SIGNALS, number}
    }
    try:
        with pytest.raises(Stopped, match=number.name), stopped_by_signals():
            try:
                os.kill(os.getpid(), number)
            finally:
                for other in usual:
                    os.kill(os.getpid(), other)
        assert not heard
        os.kill(os.getpid(), number)
        assert heard == [number]
    finally:
        for one, before in usual.items():
            signal.signal(one, before)
