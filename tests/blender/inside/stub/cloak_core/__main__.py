"""`python -m cloak_core ...` of the stub: the contracts' files and exit codes, no training.

CLOAK_STUB in the environment, a comma list, makes it misbehave: "slow" (0.1 s a step), "broken" (torn and senseless
event lines), "die" (kills itself at step 5), "refuse" (exit code 2), "crash" (exit code 1).
"""

import argparse
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


def main() -> None:
    if sys.argv[1] == "setup":
        if "refuse" in HOW:
            refuse("no libtorch.so")
        print(json.dumps({"cloak": "0.stub", "torch": "0.stub", "python": "3.11.0", "device": "CPU", "program": "x"}))
    elif sys.argv[1:3] == ["scene", "sample"]:
        sample(Path(sys.argv[sys.argv.index("--out") + 1]))
    elif sys.argv[1:3] == ["logo", "heatmap"]:
        heatmap(Path(given("--scene")), Path(given("--out")))
    elif sys.argv[1] == "evaluate":
        evaluate(Path(sys.argv[2]))
    elif sys.argv[1] == "wear":
        wear(Path(given("--people")), Path(given("--out")))
    elif sys.argv[1] == "film":
        film(Path(given("--out")))
    elif sys.argv[1] == "print":
        Path(given("--out")).mkdir()
        Path(given("--out"), "sheets.pdf").touch()
    elif sys.argv[1] == "look":
        look()
    elif sys.argv[1:3] == ["detectors", "verify"]:
        verify(sys.argv[3])
    elif sys.argv[1:3] == ["detectors", "check"]:
        check(sys.argv[3], Path(sys.argv[sys.argv.index("--image") + 1]))
    elif sys.argv[1] == "report":
        Path(sys.argv[2], "report.html").write_text("<p>report</p>")
        print(json.dumps({"report": "report.html"}))
    else:
        train(sys.argv[1:])


def given(option: str) -> str:
    """The option's value, in a word of its own or behind =."""
    joined = [word.partition("=")[2] for word in sys.argv if word.startswith(f"{option}=")]
    return joined[0] if joined else sys.argv[sys.argv.index(option) + 1]


def count(total: int) -> None:
    """Tell how far it is, as the real one does, and take so long that somebody can look."""
    with Path(given("--events")).open("a") as events:
        tell(events, {"type": "start", "step": 0, "time": 0.0, "steps": total})
        for step in range(1, total + 1):
            if "slow" in HOW:
                time.sleep(0.1)
            tell(events, {"type": "step", "step": step, "time": 0.1 * step})


def evaluate(run: Path) -> None:
    """The cloak hides the front alone; own clothing hides a tenth."""
    first, last, step = map(int, given("--angles").split(":"))
    count(8)
    rate = lambda success: (
        {"success": success, "ci95": [success - 0.05, success + 0.05], "n": 40}
        | {
            "success_own": success / 2,
            "ci95_own": [0.1, 0.2],
            "n_conditional": 36,
        }
    )
    angles = {f"{a:g}": rate(1.0 if abs(a) <= 90 else 0.0) for a in range(first, last + 1, step)}
    shares = {"logo": 0.5, "clothing": 0.1, "grey": 0.2, "random": 0.3}
    told = {name: rate(share) for name, share in shares.items()} | {"by_angle": angles}
    summary = {"detectors": {"builtin": told}, "operating_points": {"builtin": 0.5}, "n": int(given("--most-images"))}
    summary |= {"unseen": {"bodies": "--scene" not in " ".join(sys.argv), "backgrounds": True}}
    (run / "evaluation").mkdir(exist_ok=True)
    (run / "evaluation/summary.json").write_text(json.dumps(summary | {"settings": {"threshold": 0.6}}))
    (run / "evaluation/asked.json").write_text(json.dumps(sys.argv))
    print(json.dumps(summary))


def wear(people: Path, out: Path) -> None:
    """Everybody of the list wears it and is seen no more; one is left out."""
    rate = lambda success: {"success": success, "success_own": success / 2, "n": 2}
    seen = {"run": rate(1.0), "clothing": rate(0.0), "grey": rate(0.1), "random": rate(0.2)}
    specs = [word.partition("=")[2] for word in sys.argv if word.startswith("--detector=")]
    out.mkdir()
    for number in range(len(json.loads(people.read_text())["images"])):
        person = out / "pictures" / f"{number}.jpg-1"
        person.mkdir(parents=True)
        for name in ("after run.jpg", "before.jpg"):
            (person / name).touch()
    (out / "sheet.jpg").touch()
    left_out = {"hidden limbs": 1}
    print(json.dumps({"detectors": dict.fromkeys(specs, seen), "people": 2, "left_out": left_out}))


def film(out: Path) -> None:
    """No pictures, but what was asked for."""
    count(8)
    out.write_text(json.dumps(sys.argv))
    print(json.dumps({"out": str(out)}))


def look() -> None:
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
        specs = [word.partition("=")[2] for word in sys.argv if word.startswith("--detector=")]
        told = {"detectors": dict.fromkeys(specs, seen), "pictures": {"clothing": str(folder / "clothing.png")}}
        replace(folder / "look.json", told | {"width": asked["width"], "height": asked["height"]})


def replace(path: Path, record: dict) -> None:
    """All or nothing, for somebody who looks while it is written."""
    temporary = path.with_name(f".{path.name}")
    temporary.write_text(json.dumps(record))
    os.replace(temporary, path)


def sample(out: Path) -> None:
    """A triangle pyramid in two poses."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1], [0, 2, 0]], np.float32)
    triangles = np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]], np.int32)
    out.mkdir(parents=True)
    np.savez(
        out / "bodies.npz",
        vertices=np.stack([vertices, vertices * [1, 1.1, 1]]).astype(np.float32),
        triangles=triangles,
        face_colors=np.full((1, 4, 3), 0.25, np.float32),
        region_chest=np.array([True, False, True, False]),
        names=np.array(["Ann", "Bob"]),
    )
    record = {"format": "cloak scene", "version": 1, "name": "Sample"}
    (out / "scene.json").write_text(json.dumps(record))
    print(json.dumps({"out": str(out)}))


def heatmap(scene: Path, out: Path) -> None:
    """Heat rises with the face's index."""
    count(8)
    with np.load(scene / "bodies.npz") as arrays:
        faces = len(arrays["loop_total"])
    np.save(out, np.arange(faces, dtype=np.float32))
    print(json.dumps({"heat": str(out), "seen": faces - 1, "faces": faces}))


def verify(spec: str) -> None:
    """Everything works, and it reports from 0.25 on."""
    if "refuse" in HOW:
        refuse(f"{spec}: no such thing here")
    count(8)
    failed = ["gradient", "batch"] if "bad-detector" in HOW else []
    told = {"spec": spec, "operating_point": 0.25, "person_class": 0, "parity_scores": 3e-6, "failed": failed}
    if spec.startswith(("openvino:", "tflite:")) or "black-box" in HOW:
        told |= {"white_box": False, "operating_point_assumed": True, "parity_scores": None}
    print(json.dumps(told))
    sys.exit(1 if failed else 0)


def check(spec: str, image: Path) -> None:
    """Somebody is seen wherever there is no cloak."""
    assert image.read_bytes().startswith(b"\x89PNG"), image
    found = 0.1 if image.name.startswith("cloak") else 0.9
    point = float(spec.partition("conf=")[2] or 0.5)
    print(json.dumps({"max_person": found, "operating_point": point, "boxes": []}))


def train(words: list[str]) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("command", choices=["train"])
    for name in (
        "scene",
        "logo",
        "backgrounds",
        "angles",
        "preset",
        "device",
        "out",
        "config",
        "made-from",
        "init",
    ):
        parser.add_argument(f"--{name}")
    parser.add_argument("--detector", action="append")
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--resume", action="store_true")
    options = parser.parse_args(words)
    run = Path(options.out)
    if run.exists() and not options.resume:
        refuse(f"{run}: exists already")
    if "refuse" in HOW:
        refuse("--detector builtin: no such thing here")
    if "crash" in HOW:
        raise RuntimeError("a defect")
    ids = np.load(options.logo)
    run.mkdir(exist_ok=True)
    np.save(run / "logo.npy", ids)
    (run / "logo.json").write_text(Path(options.logo).with_suffix(".json").read_text())
    (run / "config.json").write_text(
        json.dumps({"format": "cloak run", "detectors": [{"spec": spec} for spec in options.detector]})
    )
    (run / "cancel").unlink(missing_ok=True)
    held = (run / ".lock").open("a")
    fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    memory = run / "step.txt"
    first = int(memory.read_text()) if options.resume and memory.exists() else 0
    stopped = None
    with (run / "events.jsonl").open("a") as events:
        tell(events, {"type": "resume" if first else "start", "step": first, "time": 0.0, "steps": options.steps})
        for step in range(first + 1, options.steps + 1):
            write_red(run, len(ids))
            remember(memory, step)
            tell(events, {"type": "step", "step": step, "time": 0.1 * step, "loss": 1 / step, "success": step / 100})
            misbehave(events, step)
            if (run / "cancel").exists():
                stopped = f"stopped at step {step}: cancel file"
                break
        tell(events, {"type": "end", "step": step, "time": 0.1 * step, "outcome": "stopped" if stopped else "done"})
    print(json.dumps({"out": str(run), "step": step, **({"stopped": stopped} if stopped else {})}))
    sys.exit(3 if stopped else 0)


def refuse(message: str) -> None:
    print(f"cloak: {message}", file=sys.stderr)
    sys.exit(2)


def write_red(run: Path, count: int) -> None:
    temporary = run / ".colors.npy"
    np.save(temporary, np.tile(np.float32([1, 0, 0]), (count, 1)))
    os.replace(temporary, run / "colors.npy")


def remember(memory: Path, step: int) -> None:
    """All or nothing, as the real trainer writes: it may be killed at any moment."""
    temporary = memory.with_name(".step.txt")
    temporary.write_text(str(step))
    os.replace(temporary, memory)


def tell(events, event: dict) -> None:
    events.write(json.dumps(event) + "\n")
    events.flush()


def misbehave(events, step: int) -> None:
    if "slow" in HOW:
        time.sleep(0.1)
    if "broken" in HOW:
        events.write('{"type": "step", "step"\n[1, 2]\n\xff\xfe\n{"type": "step", "step": NaN, "loss": "x"}\n')
        events.write('{"type": "step", "step": 1, "loss": Infinity, "success": true, "time": null}\n')
        events.flush()
    if "die" in HOW and step == 5:
        os.kill(os.getpid(), signal.SIGKILL)


main()
