"""Work of several trainings, killed at random moments and begun again, in processes of their own.

    python -m tests.experiments.killed_work assess|reproduce|transfer FOLDER KILLS

prints {"kills", "within", "differences", "left"}: how many of the kills hit work that was not finished, which figures
differ from those of the work that nobody killed, and files that killed writers left.
"""

import json
import os
import random
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

from cloak_core.experiments.runner import run_experiment
from cloak_core.studies.card.assess import Assessment
from cloak_core.studies.card.page import write_card
from cloak_core.studies.store import RunStore
from cloak_core.studies.transfer import gather
from tests.studies import test_transfer_matrix as matrices
from tests.studies.made_split import TINY, Bulb, make_options, make_split, make_store

TIMES = ("seconds", "time", "made", "date", "ms")
"""Words in the names of figures that differ from run to run."""


def assess(out: Path) -> object:
    """A card of a tiny budget."""
    Assessment(make_store(out, Bulb("glow")), TINY, out / "glow", []).run()
    write_card(out / "glow")
    return json.loads((out / "glow" / "card.json").read_text())


def reproduce(out: Path) -> object:
    """An experiment of two trainings, each judged on both detectors."""
    run_experiment("transfer", RunStore(make_split(), make_options(out, seeds=1)))
    return json.loads((out / "transfer" / "numbers.json").read_text())


def transfer(out: Path) -> object:
    """Two cells of the leave-one-out matrix."""
    matrices.matrix(out, judges=("yolo:a", "onnx:red.onnx")).fill(["best"])
    return gather(out)


WORK: dict[str, Callable[[Path], object]] = {"assess": assess, "reproduce": reproduce, "transfer": transfer}


def timeless(value: object) -> object:
    """Figures without what tells time, or the folder."""
    if isinstance(value, dict):
        return {k: timeless(v) for k, v in value.items() if not any(word in k.lower() for word in TIMES)}
    return [timeless(item) for item in value] if isinstance(value, list) else value


def differences(one: object, other: object, name: str = "") -> list[str]:
    """Names of the figures in which two records differ."""
    if isinstance(one, dict) and isinstance(other, dict):
        keys = sorted({*one, *other})
        return [found for key in keys for found in differences(one.get(key), other.get(key), f"{name}.{key}")]
    if isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        return [
            found for i, both in enumerate(zip(one, other, strict=True)) for found in differences(*both, f"{name}[{i}]")
        ]
    return [] if one == other else [name]


def begun(work: Callable[[Path], object], out: Path) -> int:
    """The process that does the work."""
    child = os.fork()
    if not child:
        os.setsid()
        code = 1
        try:
            work(out)
            code = 0
        finally:
            os._exit(code)
    return child


def killed(kind: str, folder: Path, kills: int) -> dict[str, object]:
    """Do the work whole; then again, killed at random moments."""
    work, draw = WORK[kind], random.Random(0)
    whole = timeless(work(folder / "whole"))  # loops are compiled from now on, also in children
    start = time.perf_counter()
    child = begun(work, folder / "timed")
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    took = time.perf_counter() - start
    within = 0
    for _ in range(kills):
        child = begun(work, folder / "killed")
        time.sleep(draw.uniform(0, 1.2 / kills) * took)  # what was done stays done
        os.kill(child, signal.SIGKILL)
        within += os.WIFSIGNALED(os.waitpid(child, 0)[1])
    ended = timeless(work(folder / "killed"))
    left = [path.name for path in (folder / "killed").rglob(".*") if path.name != ".lock"]
    return {"kills": kills, "within": within, "differences": differences(whole, ended), "left": left}


if __name__ == "__main__":
    which, place, count = sys.argv[1:]
    print(json.dumps(killed(which, Path(place), int(count))))
