import os
import signal
import threading

import pytest

from cloak_core.core.loop import stop_request


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_asks_once_and_then_acts(tmp_path, number):
    heard = []
    before = signal.signal(number, lambda *_: heard.append("ours"))
    try:
        with stop_request(tmp_path / "cancel") as stop:
            assert stop.reason(0.0) == ""
            os.kill(os.getpid(), number)
            assert stop.reason(0.0) == signal.Signals(number).name
            assert heard == []
            os.kill(os.getpid(), number)
            assert heard == ["ours"]
        os.kill(os.getpid(), number)
        assert heard == ["ours", "ours"]
    finally:
        signal.signal(number, before)


def test_other_threads_leave_the_handlers_alone(tmp_path):
    before = signal.getsignal(signal.SIGTERM)
    seen = []

    def work():
        with stop_request(tmp_path / "cancel") as stop:
            seen.append((signal.getsignal(signal.SIGTERM) is before, stop.reason(0.0)))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [(True, "")]
