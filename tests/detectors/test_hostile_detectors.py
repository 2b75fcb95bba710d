"""Hostile detectors of `python:`: each works, or is refused in one line that names its file; the process is as before.

The cases are accidents that inference scripts hold, not malice, against which nothing in one process helps.
"""

import os
import random
import signal
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
import torch

from cloak_core.detectors.loading import load_detector
from cloak_core.files.errors import InputError
from tests.detectors.helpers import images

CODE = """
import os, random, signal, sys, tempfile, warnings
import numpy
import torch
IMPORT
class Mine(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.ones(1))
    def forward(self, images):
        count = len(images)
        boxes = images.new_tensor([1.0, 2.0, 9.0, 12.0]).expand(count, 3, 4)
        scores = (images.mean((1, 2, 3))[:, None] * self.weight).expand(count, 3)
        CALL
        return boxes, scores
def load():
    LOAD
    return Mine()
"""
CHANGES = {
    "gradients": "torch.set_grad_enabled(False)",
    "inference mode": "torch.inference_mode().__enter__()",
    "default device": "torch.set_default_device('meta')",
    "default type": "torch.set_default_dtype(torch.float64)",
    "threads": "torch.set_num_threads(torch.get_num_threads() + 1)",
    "deterministic": "torch.use_deterministic_algorithms(True)",
    "autocast": "torch.set_autocast_enabled('cpu', True)",
    "folder": "os.chdir(tempfile.gettempdir())",
    "seeds": "torch.manual_seed(7); numpy.random.seed(7); random.seed(7)",
    "import path": "sys.path.insert(0, tempfile.gettempdir())",
    "no import path": "sys.path.clear()",
    "output": "sys.stdout = sys.stderr = open(os.devnull, 'w')",
    "warnings": "warnings.simplefilter('error')",
    "numpy's errors": "numpy.seterr(all='raise')",
}
"""What is set back, whether it is done when the file is imported, when it is loaded, or when it is called."""
SIGNALS = "signal.signal(signal.SIGINT, signal.SIG_IGN); signal.signal(signal.SIGTERM, signal.SIG_IGN)"
WORKS = {
    "a list instead of a tuple": "return [boxes, scores]",
    "more than was asked for": "return boxes, scores, 'more', 5",
    "no boxes": "return boxes[:, :0], scores[:, :0]",
    "double precision": "return boxes.double(), scores.double()",
    "strides of zero": "return boxes[:, :1].expand(-1, 50, -1), scores[:, :1].expand(-1, 50)",
    "much output": "print('x' * 100_000); print('y' * 100_000, file=sys.stderr)",
    "warnings": "warnings.warn('old'); warnings.warn('older', DeprecationWarning)",
}
REFUSED = {
    "nothing": "return None",
    "a dict": "return {'boxes': boxes, 'scores': scores}",
    "scores alone": "return scores",
    "five columns": "return torch.cat([boxes, boxes[..., :1]], 2), scores",
    "one score too few": "return boxes, scores[:, :-1]",
    "arrays": "return boxes.numpy(), scores.detach().numpy()",
    "a generator": "return (part for part in (boxes, scores))",
    "text": "return 'boxes', 'scores'",
    "whole numbers": "return boxes.int(), scores",
    "truths": "return boxes, scores > 0.5",
    "complex numbers": "return boxes, scores.to(torch.complex64)",
    "sparse": "return boxes.to_sparse(), scores",
    "infinite scores": "return boxes, scores + float('inf')",
    "logits": "return boxes, scores * 20 - 10",
    "infinite boxes": "return boxes + float('inf'), scores",
    "boxes on another device": "return torch.zeros(count, 3, 4, device='meta'), scores",
    "another device": "return boxes, torch.zeros(count, 3, device='meta')",
    "changed images": "images.data.zero_()",
    "chance": "return boxes, (scores * torch.rand(1)).clamp(0, 1)",
    "an exception": "raise RuntimeError('two\\nlines \\x1b[31m')",
    "an exception without words": "raise type('E', (Exception,), {'__str__': lambda self: 1 / 0})",
    "recursion": "return self(images)",
    "a stop": "raise StopIteration",
    "an import": "import no_such_package",
    "another signature": "return self.forward()",
}
"""Bodies of `forward`."""
NOT_LOADED = {
    "an exit": {"IMPORT": "sys.exit(3)"},
    "a syntax error": {"IMPORT": "def f(:"},
    "a null character": {"IMPORT": "'\0'"},
    "nothing": {"LOAD": "return None"},
    "a class": {"LOAD": "return Mine"},
    "names that are none": {"LOAD": "Mine.class_names = 5"},
    "a property that fails": {"LOAD": "Mine.differentiable = property(lambda self: 1 / 0)"},
    "weights without numbers": {"LOAD": "return Mine().to('meta')"},
    "changes, then an error": {"IMPORT": "torch.set_grad_enabled(False); os.chdir('/'); 1 / 0"},
    "eval that fails": {"LOAD": "Mine.train = lambda self, mode=True: 1 / 0"},
}


def process() -> dict[str, object]:
    return {
        "gradients": torch.is_grad_enabled(),
        "inference": torch.is_inference_mode_enabled(),
        "kinds": (torch.get_default_dtype(), torch.get_default_device()),
        "threads": torch.get_num_threads(),
        "deterministic": torch.are_deterministic_algorithms_enabled(),
        "autocast": torch.is_autocast_enabled("cpu"),
        "folder": os.getcwd(),
        "output": (sys.stdout, sys.stderr),
        "numpy": np.geterr(),
        "signals": (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)),
        "errors": [rule for rule in warnings.filters if rule[0] == "error"],
        "path": sys.path[:3],
    }


def written(folder: Path, **parts: str) -> str:
    text = CODE
    for name in ("IMPORT", "CALL", "LOAD"):
        text = text.replace(name, parts.get(name, "pass"))
    (folder / "mine.py").write_text(text)
    return "python:mine.py:load"


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("where", ["IMPORT", "LOAD", "CALL"])
@pytest.mark.parametrize("change", CHANGES)
def test_what_it_changes_is_set_back(change: str, where: str, here: Path) -> None:
    before = process()
    torch.manual_seed(0)
    try:
        detector = load_detector(written(here, **{where: CHANGES[change]}))
        assert process() == before
        detector(images(2, 16, 12).requires_grad_()).scores.sum().backward()
    except InputError as error:  # it cannot be a detector with that
        assert "mine.py" in str(error) and (where == "CALL" or change in ("default device", "inference mode")), error
    assert process() == before
    assert torch.initial_seed() == 0


def test_a_signal_stays_whose_it_was(here: Path) -> None:
    before = process()
    load_detector(written(here, IMPORT=SIGNALS))
    assert process() == before


def test_seeds_of_others_go_on(here: Path) -> None:
    """A detector that sets a seed does not decide which numbers are drawn after it."""
    seeded = []
    for where in ("IMPORT", "CALL"):
        torch.manual_seed(1), np.random.seed(1), random.seed(1)
        load_detector(written(here, **{where: CHANGES["seeds"]}))(images(2, 16, 12).requires_grad_())
        seeded.append((torch.rand(1).item(), np.random.random(), random.random()))
    torch.manual_seed(7), np.random.seed(7), random.seed(7)
    assert (torch.rand(1).item(), np.random.random(), random.random()) not in seeded


@pytest.mark.parametrize("answer", WORKS)
def test_answers_that_are_taken(answer: str, here: Path) -> None:
    before = process()
    found = load_detector(written(here, CALL=WORKS[answer]))(images(2, 16, 12).requires_grad_())
    assert len(found.scores) == 2 and bool(found.boxes.isfinite().all()) and process() == before


@pytest.mark.parametrize("answer", REFUSED)
def test_answers_that_are_refused(answer: str, here: Path) -> None:
    before = process()
    detector = load_detector(written(here, CALL=REFUSED[answer]))
    state = images(2, 16, 12).requires_grad_()
    with pytest.raises(InputError) as caught:
        for _ in range(2):
            detector(state)
        detector.verify("")
    assert str(caught.value).isprintable() and "mine.py" in str(caught.value)
    assert process() == before


@pytest.mark.parametrize("fault", NOT_LOADED)
def test_files_that_are_refused(fault: str, here: Path) -> None:
    before = process()
    with pytest.raises(InputError) as caught:
        load_detector(written(here, **NOT_LOADED[fault]))
    assert str(caught.value).isprintable() and "mine.py" in str(caught.value)
    assert process() == before


@pytest.mark.timeout(60, method="thread")  # its other method takes the process's alarm, which is what is tested
@pytest.mark.parametrize("wait", ["while True: pass", "import time; time.sleep(1000)"])
@pytest.mark.parametrize("where", ["IMPORT", "LOAD", "CALL"])
def test_code_that_never_returns_is_ended(where: str, wait: str, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spec = written(here, **{where: wait})
    lines = (here / "mine.py").read_text().splitlines()
    line = next(number for number, text in enumerate(lines, 1) if wait in text)
    monkeypatch.setenv("CLOAK_DETECTOR_SECONDS", "0.3")
    before = signal.getsignal(signal.SIGALRM)
    with pytest.raises(InputError, match=rf"mine\.py:load: .*mine\.py:{line}: no answer in 0\.3 s"):
        load_detector(spec)(images(2, 16, 12).requires_grad_())
    assert signal.getsignal(signal.SIGALRM) is before and signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


@pytest.mark.timeout(60, method="thread")
@pytest.mark.parametrize("said", ["soon", "-1", "nan"])
def test_a_limit_that_is_no_number_is_refused(said: str, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CLOAK_DETECTOR_SECONDS", said)
    with pytest.raises(InputError, match=f"CLOAK_DETECTOR_SECONDS: '{said}' is no number of seconds"):
        load_detector(written(here))
