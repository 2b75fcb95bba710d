"""`python -m cloak_core ...` of the stub: the contracts' files and exit codes, no training.

CLOAK_STUB in the environment, a comma list, makes it misbehave: "slow" (0.1 s a step), "broken" (torn and senseless
event lines), "die" (kills itself at step 5), "refuse" (exit code 2), "crash" (exit code 1).
"""

import fcntl
import json
import os
import signal
import sys
import time
from pathlib import Path

import numpy as np

HOW = os.environ.get("CLOAK_STUB", "").split(",")
assert "" not in sys.path and os.getcwd() not in sys.path, "the current folder must not be on the trainer's path"
assert not {"PYTHONHOME"} & set(os.environ)


def every(option: str) -> list[str]:
    """All values of an option, in words of their own or behind =."""
    words = [word.partition("=")[2] for word in sys.argv if word.startswith(f"{option}=")]
    return words or [sys.argv[place + 1] for place, word in enumerate(sys.argv) if word == option]


def given(option: str) -> str:
    return every(option)[0]


def refuse(message: str) -> None:
    print(f"cloak: {message}", file=sys.stderr)
    sys.exit(2)


def replace(path: Path, record: dict) -> None:
    """All or nothing, as the real trainer writes: somebody looks, and it may be killed at any moment."""
    temporary = path.with_name(f".{path.name}")
    temporary.write_text(json.dumps(record))
    os.replace(temporary, path)


def tell(events, **event: object) -> None:
    events.write(json.dumps(event) + "\n")
    events.flush()
    if "slow" in HOW and event["type"] == "step":
        time.sleep(0.1)


def count(total: int) -> None:
    """Tell how far it is, as the real one does, and take so long that somebody can look."""
    with Path(given("--events")).open("a") as events:
        tell(events, type="start", step=0, time=0.0, steps=total)
        for step in range(1, total + 1):
            tell(events, type="step", step=step, time=0.1 * step)


def setup() -> dict:
    if "refuse" in HOW:
        refuse("no libtorch.so")
    return {"cloak": "0.stub", "torch": "0.stub", "python": "3.11.0", "device": "CPU", "program": "x"}


def rate(success: float) -> dict:
    known = {"success": success, "ci95": [success - 0.05, success + 0.05], "n": 40, "n_conditional": 36}
    return known | {"success_own": success / 2, "ci95_own": [0.1, 0.2]}


def evaluate() -> dict:
    """The cloak hides the front alone; own clothing hides a tenth."""
    run, (first, last, step) = Path(sys.argv[2]), map(int, given("--angles").split(":"))
    count(8)
    angles = {f"{a:g}": rate(1.0 if abs(a) <= 90 else 0.0) for a in range(first, last + 1, step)}
    shares = {"logo": 0.5, "clothing": 0.1, "grey": 0.2, "random": 0.3}
    told = {name: rate(share) for name, share in shares.items()} | {"by_angle": angles}
    summary = {"detectors": {"builtin": told}, "operating_points": {"builtin": 0.5}, "n": int(given("--most-images"))}
    summary |= {"unseen": {"bodies": not every("--scene"), "backgrounds": True}, "settings": {"threshold": 0.6}}
    (run / "evaluation").mkdir(exist_ok=True)
    replace(run / "evaluation/summary.json", summary)
    (run / "evaluation/asked.json").write_text(json.dumps(sys.argv))
    return summary


def wear() -> dict:
    """Everybody of the list wears it and is seen no more; one is left out."""
    seen = {"run": rate(1.0), "clothing": rate(0.0), "grey": rate(0.1), "random": rate(0.2)}
    out = Path(given("--out"))
    for number in range(len(json.loads(Path(given("--people")).read_text())["images"])):
        person = out / "pictures" / f"{number}.jpg-1"
        person.mkdir(parents=True)
        for name in ("after run.jpg", "before.jpg"):
            (person / name).touch()
    told = {"detectors": dict.fromkeys(every("--detector"), seen), "people": 2, "left_out": {"hidden limbs": 1}}
    return told | {"operating_points": dict.fromkeys(every("--detector"), 0.5)}


def film() -> dict:
    """No pictures, but what was asked for."""
    count(8)
    Path(given("--out")).write_text(json.dumps(sys.argv))
    return {"out": given("--out")}


def print_sheets() -> dict:
    Path(given("--out")).mkdir()
    return {"out": given("--out")}


def report() -> dict:
    Path(sys.argv[2], "report.html").write_text("<p>report</p>")
    return {"report": "report.html"}


def look() -> dict:
    """Somebody stands in the left half of every picture, and the cloak hides them."""
    for line in sys.stdin:
        asked = json.loads(line)
        folder, box = Path(asked["out"]), [0, 0, asked["width"] / 2, asked["height"], 0.9]
        seen = {"operating_point": 0.5, "clothing": {"max_person": 0.9, "boxes": [box]}}
        if "colors" in asked:
            assert len(np.load(asked["colors"])) == len(np.load(asked["logo"]))
            seen["cloak"] = {"max_person": 0.2, "boxes": [[*box[:4], 0.2]]}
        with np.load(Path(asked["scene"]) / "bodies.npz") as arrays:
            asked["lowest"] = float(arrays["vertices"][..., 1].min())
        replace(folder / "asked.json", asked)
        told = {"detectors": dict.fromkeys(every("--detector"), seen), "width": asked["width"]}
        pictures = {"clothing": str(folder / "clothing.png")}
        replace(folder / "look.json", told | {"pictures": pictures, "height": asked["height"]})
    return {}


def sample() -> dict:
    """A triangle pyramid in two poses."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1], [0, 2, 0]], np.float32)
    out = Path(given("--out"))
    out.mkdir(parents=True)
    pieces = {"body": 3, "shirt": 0, "trousers": 1} if "--clothed" in sys.argv else {}
    triangles = np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]], np.int32)
    np.savez(
        out / "bodies.npz",
        vertices=np.stack([vertices, vertices * [1, 1.1, 1]]).astype(np.float32),
        triangles=triangles,
        loop_total=np.full(4, 3, np.int32),
        loop_vertices=triangles.ravel(),
        face_colors=np.full((1, 4, 3), 0.25, np.float32),
        region_chest=np.array([True, False, True, False]),
        names=np.array(["Ann", "Bob"]),
        **{f"region_{name}": np.arange(4) == place for name, place in pieces.items()},
    )
    replace(out / "scene.json", {"format": "cloak scene", "version": 1, "name": "Sample"})
    return {"out": str(out)}


def heatmap() -> dict:
    """Heat rises with the face's index."""
    count(8)
    with np.load(Path(given("--scene")) / "bodies.npz") as arrays:
        faces = len(arrays["loop_total"])
    np.save(given("--out"), np.arange(faces, dtype=np.float32))
    return {"heat": given("--out"), "seen": faces - 1, "faces": faces}


def verify() -> dict:
    """Everything works, and it reports from 0.25 on."""
    spec = sys.argv[3]
    if "refuse" in HOW:
        refuse(f"{spec}: no such thing here")
    count(8)
    failed = ["gradient", "batch"] if "bad-detector" in HOW else []
    told = {"spec": spec, "operating_point": 0.25, "person_class": 0, "parity_scores": 3e-6, "failed": failed}
    if spec.startswith(("openvino:", "tflite:")) or "black-box" in HOW:
        told |= {"white_box": False, "operating_point_assumed": True, "parity_scores": None}
    return told


def check() -> dict:
    """Somebody is seen wherever there is no cloak."""
    image = Path(given("--image"))
    assert image.read_bytes().startswith(b"\x89PNG"), image
    point = float(sys.argv[3].partition("conf=")[2] or 0.5)
    return {"max_person": 0.1 if image.name.startswith("cloak") else 0.9, "operating_point": point, "boxes": []}


TRAIN = {"scene", "logo", "backgrounds", "angles", "preset", "device", "out", "config", "made-from", "init"}
TRAIN |= {"detector", "steps", "json", "resume"}


def train() -> dict:
    unknown = [word for word in sys.argv[2:] if word.startswith("--") and word[2:].partition("=")[0] not in TRAIN]
    run, resume, steps = Path(given("--out")), "--resume" in sys.argv, int((every("--steps") or ["20"])[0])
    assert not unknown, unknown
    if run.exists() and not resume:
        refuse(f"{run}: exists already")
    if "refuse" in HOW:
        refuse("--detector builtin: no such thing here")
    if "crash" in HOW:
        raise RuntimeError("a defect")
    ids = np.load(given("--logo"))
    run.mkdir(exist_ok=True)
    np.save(run / "logo.npy", ids)
    (run / "logo.json").write_text(Path(given("--logo")).with_suffix(".json").read_text())
    replace(run / "config.json", {"format": "cloak run", "detectors": [{"spec": s} for s in every("--detector")]})
    (run / "cancel").unlink(missing_ok=True)
    held = (run / ".lock").open("a")
    fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    memory = run / "step.txt"
    first = int(memory.read_text()) if resume and memory.exists() else 0
    outcome = "done"
    with (run / "events.jsonl").open("a") as events:
        tell(events, type="resume" if first else "start", step=first, time=0.0, steps=steps)
        for step in range(first + 1, steps + 1):
            np.save(run / ".colors.npy", np.tile(np.float32([1, 0, 0]), (len(ids), 1)))
            os.replace(run / ".colors.npy", run / "colors.npy")
            replace(memory, step)
            tell(events, type="step", step=step, time=0.1 * step, loss=1 / step, success=step / 100)
            misbehave(events, step)
            if (run / "cancel").exists():
                outcome = "stopped"
                break
        tell(events, type="end", step=step, time=0.1 * step, outcome=outcome)
    return {"out": str(run), "step": step, "stopped": outcome == "stopped"}


def misbehave(events, step: int) -> None:
    if "broken" in HOW:
        events.write('{"type": "step", "step"\n[1, 2]\n\xff\xfe\n{"type": "step", "step": NaN, "loss": "x"}\n')
        events.write('{"type": "step", "step": 1, "loss": Infinity, "success": true, "time": null}\n')
        events.flush()
    if "die" in HOW and step == 5:
        os.kill(os.getpid(), signal.SIGKILL)


COMMANDS = {"scene": sample, "logo": heatmap, "print": print_sheets, "detectors": check}
COMMANDS |= {f.__name__: f for f in (setup, evaluate, wear, film, look, report, train)}
answer = verify() if sys.argv[2:3] == ["verify"] else COMMANDS[sys.argv[1]]()
print(json.dumps(answer))
sys.exit(1 if answer.get("failed") else 3 if answer.get("stopped") else 0)
