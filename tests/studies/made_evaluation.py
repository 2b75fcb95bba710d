"""A hand-made evaluation in a hand-made run folder: known scores, small pictures."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
from PIL import Image

from cloak_core.core.evaluation.results import Results, make_results
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.evaluation.statistics import summarize
from cloak_core.core.evaluation.trials import draw_trials
from cloak_core.studies.report.pictures import describe

CONTROLS = ("logo", "clothing", "grey", "random")


def made_results(
    specs: tuple[str, ...] = ("builtin",),
    bodies: tuple[str, ...] = ("walking Ada", "standing Bo", "running Cy"),
    score: np.ndarray | None = None,
    backgrounds: tuple[str, ...] = tuple(f"street {i}.jpg" for i in range(30)),
) -> Results:
    """3 bodies x 5 angles x 4 images; the logo works but on the last body, the controls hardly; or `score`."""
    rng = np.random.default_rng(3)
    trials = draw_trials(len(bodies), (-10.0, -5.0, 0.0, 5.0, 10.0), 30, 1, EvaluateSettings())
    count = len(trials)
    if score is None:
        mean = np.array([0.2, 0.95, 0.9, 0.8])[:, None] + np.zeros((4, count))
        mean[0, (trials["pose"] == len(bodies) - 1).to_numpy()] = 0.5
        score = np.clip(mean + 0.12 * rng.normal(size=(len(specs), 4, count)), 0.01, 0.99).astype(np.float32)
    score_on = np.where(rng.random(score.shape) < 0.1, 0, score).astype(np.float32)
    at = np.nonzero(score > 0.3)
    boxes = dict(zip(("detector", "control", "image"), at, strict=True))
    boxes |= {"score": score[at], "hit": score_on[at] > 0, "iou": np.where(score_on[at] > 0, 0.8, 0.1)}
    bare = np.linspace(0, 0.7, 30, dtype=np.float32)[None].repeat(len(specs), 0)
    names = {"body_names": bodies, "background_names": backgrounds}
    return make_results(dict.fromkeys(specs), CONTROLS, trials, score, score_on, bare, boxes, **names)


def make_summary(results: Results) -> dict:
    inputs = {"bodies": list(results.body_names), "scene": "unseen", "topology": "ab" * 32, "backgrounds": 30}
    inputs |= {"logo_faces": 120, "detector_hashes": dict.fromkeys(results.detectors, "cd" * 32)}
    settings = asdict(EvaluateSettings()) | {"angles": [-10.0, -5.0, 0.0, 5.0, 10.0]}
    told = {"n": len(results.trials), "unseen": {"bodies": True, "backgrounds": True}, "warnings": []}
    return summarize(results, 0.6, 200) | told | {"settings": settings, "inputs": inputs}


def write_run(folder: Path, config: dict | None = None, results: Results | None = None) -> Path:
    """A run folder with events, and an evaluation where results are given."""
    folder.mkdir()
    config = config or {"format": "cloak run", "settings": {"preset": "best", "seed": 0, "angles": "-10:10:5"}}
    (folder / "config.json").write_text(json.dumps(config))
    told = lambda k: {"loss": 1 / k, "disappearance": 0.8 / k, "tv": 0.1, "success": 1 - 1 / k}
    steps = [{"type": "step", "step": k, "time": k * 0.5} | told(k) for k in range(1, 120)]
    (folder / "events.jsonl").write_text("\n".join(map(json.dumps, steps)) + "\n")
    if results:
        evaluation = folder / "evaluation"
        (evaluation / "pictures").mkdir(parents=True)
        results.save(evaluation / "scores.npz")
        (evaluation / "summary.json").write_text(json.dumps(make_summary(results)))
        (evaluation / "pictures.json").write_text(json.dumps(make_pictures(evaluation / "pictures", results)))
    return folder


def make_pictures(folder: Path, results: Results) -> dict:
    """What `write_pictures` returns, with flat colours for images."""

    def shoot(trial: int, control: str) -> dict:
        name = f"{trial:05d}-{control}.jpg"
        c = CONTROLS.index(control)
        Image.new("RGB", (416, 416), (60 + 40 * c, 120, 100 + trial % 100)).save(folder / name)
        scores = {spec: float(results.scores(spec, control)[trial]) for spec in results.detectors}
        boxes = {spec: [[120.0, 40.0, 280.0, 400.0, s]] if s > 0.3 else [] for spec, s in scores.items()}
        return {"file": name, "scores": scores, "boxes": boxes}

    label = lambda trial: describe(results, trial) | {"distance": 2.2}
    pair = lambda t: label(t) | {"clothing": shoot(t, "clothing"), "logo": shoot(t, "logo")}
    score = results.scores(results.detectors[0], "logo")
    worst = [int(i) for i in np.argsort(-score)[:6] if score[i] > 0.6]
    Image.new("RGBA", (120, 300), (200, 40, 90, 255)).save(folder / "flat.png")
    return {
        "thresholds": dict.fromkeys(results.detectors, 0.3),
        "gallery": [pair(t) for t in range(0, len(results.trials), 4)],
        "failures": {spec: [pair(t) for t in worst] for spec in results.detectors},
        "worst": {spec: [pair(worst[0]) | {"success": 0.25}] for spec in results.detectors},
        "controls": label(8) | {"images": {c: shoot(8, c) for c in CONTROLS}},
        "flat": dict.fromkeys(("front", "left", "back", "right"), "flat.png"),
    }
