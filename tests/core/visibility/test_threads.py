"""Work shared among threads leaves torch's own number of threads alone, for threads that come later, too."""

import threading
import time

import pytest
import torch

from cloak_core.core.visibility.threads import spread, torch_threads


@pytest.fixture(autouse=True)
def two_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def in_a_new_thread() -> int:
    found = []
    thread = threading.Thread(target=lambda: found.append(torch.get_num_threads()))
    thread.start()
    thread.join()
    return found[0]


def test_spreading_work_changes_nothing_for_later_threads() -> None:
    caller = threading.current_thread()

    def work(item: int) -> int:
        time.sleep(0.0 if threading.current_thread() is caller else 0.1)  # the helpers end last
        assert torch.get_num_threads() == 1
        return item * item

    assert spread(work, range(3), 3) == [0, 1, 4]
    assert torch.get_num_threads() == in_a_new_thread() == 2


def test_one_thread_is_over_at_its_end() -> None:
    with torch_threads(1):
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == in_a_new_thread() == 2
