"""How a run is ended in order: a cancel file, a signal, or a spent time budget. Checked once per step."""

import contextlib
import signal
import threading
from collections.abc import Iterator
from pathlib import Path

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopRequest:
    """Says why to stop, or "" to go on."""

    def __init__(self, cancel_file: Path, max_seconds: float | None) -> None:
        self._cancel_file = cancel_file
        self._max_seconds = max_seconds
        self.signal: str = ""

    def reason(self, seconds: float) -> str:
        """Give the reason to stop after `seconds` of training."""
        if self.signal:
            return self.signal
        if self._cancel_file.exists():
            return "cancel file"
        if self._max_seconds is not None and seconds >= self._max_seconds:
            return "time budget"
        return ""


@contextlib.contextmanager
def stop_request(cancel_file: Path, max_seconds: float | None = None) -> Iterator[StopRequest]:
    """Listen for SIGINT and SIGTERM during the block; a second one acts as it would without us.

    Outside the main thread, where Python takes no handlers, only the file and the budget count.
    """
    request = StopRequest(cancel_file, max_seconds)
    if threading.current_thread() is not threading.main_thread():
        yield request
        return
    previous = {number: signal.getsignal(number) for number in SIGNALS}

    def remember(number: int, frame: object) -> None:
        request.signal = signal.Signals(number).name
        signal.signal(number, previous[number])

    for number in SIGNALS:
        signal.signal(number, remember)
    try:
        yield request
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
