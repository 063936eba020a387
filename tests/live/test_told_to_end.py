"""A signal that asks a program to end in order."""

import os
import signal

import pytest

from rcmservo.live.lab import Stopped
from rcmservo.live.told_to_end import ORDERLY, stopped_by_signals


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_the_first_signal_stops_in_order_and_the_next_interrupts_nothing(
    number: signal.Signals,
) -> None:
    usual = signal.signal(number, signal.SIG_DFL)  # ignored in a script's background
    try:
        with pytest.raises(Stopped, match=number.name), stopped_by_signals():
            try:
                os.kill(os.getpid(), number)
            finally:
                for other in ORDERLY:
                    os.kill(os.getpid(), other)
        assert signal.getsignal(number) is signal.SIG_DFL
    finally:
        signal.signal(number, usual)
