"""Signals that end a program in order."""

import os
import signal

import pytest

from rcmservo.errors import Stopped
from rcmservo.live.stop_signals import END_SIGNALS, stopped_by_signals


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_the_first_signal_stops_in_order_and_the_next_is_ignored(
    number: signal.Signals,
) -> None:
    received: list[int] = []
    previous = {
        received_number: signal.signal(received_number, lambda n, _: received.append(n))
        for received_number in {*END_SIGNALS, number}
    }
    try:
        with pytest.raises(Stopped, match=number.name), stopped_by_signals():
            try:
                os.kill(os.getpid(), number)
            finally:
                for other in previous:
                    os.kill(os.getpid(), other)
        assert not received
        os.kill(os.getpid(), number)
        assert received == [number]
    finally:
        for each, handler in previous.items():
            signal.signal(each, handler)
