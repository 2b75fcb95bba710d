"""Measure whether success on renders predicts success on photographs of people: a rank correlation over textures.

    python tools/predict_photographs.py COLORS ... --people PEOPLE.json --scene BODIES.npz --detector SPEC ... --out DIR

COLORS are those of `cloak wear`. Each is worn by the people, and in every setting of `RENDERS` by bodies of the first
--scene that has its logo's mesh (a run of another mesh: by its own unseen bodies; pictures: as cloth on shirt and
trousers of the first scene). DIR keeps what was measured, so that a stopped call goes on. DIR/correlation.json has the
success of every texture and, for each setting, Spearman's rank correlation of its mean over the detectors with that on
photographs, and a 95 % interval by bootstrap over textures.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.logo import load_logo
from cloak_core.core.pattern import Pattern
from cloak_core.detectors.loading import load_detector
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.reading import read_json
from cloak_core.files.writing import write_json
from cloak_core.library.values import cast_of
from cloak_core.sources.backdrops.backgrounds import Backgrounds, load_backgrounds
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.studies.evaluate import OnBodies, evaluate
from cloak_core.studies.opening import CLOTHES, FLIPPED, open_pattern, open_run
from cloak_core.studies.trained_run import kept_back, read_run
from cloak_core.studies.wearing.wearing import wear_and_judge
from cloak_core.zoo.entry import run_path

FRONT, AROUND = np.arange(-10.0, 11, 5), np.arange(0.0, 360, 45)
RENDERS: dict[str, tuple[np.ndarray, dict]] = {
    "front": (FRONT, {}),
    "around": (AROUND, {}),
    "around, 4.4 m": (AROUND, {"distances": (4.4,)}),
    "around, 208 pixels": (AROUND, {"size": 208, "shift": 25}),
    "around, Cycles in a studio": (AROUND, {"cycles": "studio"}),
}
"""Azimuths and what differs from the default settings of `cloak evaluate`."""
RATES = ("success", "success_own")
CONTROLS = ("clothing", "grey")


def opened(spec: str, scenes: list) -> tuple[Pattern, Bodies]:
    """Open one of COLORS, and a scene whose bodies can wear it."""
    if "@tile=" in spec or "@patch=" in spec or spec.startswith("print:") or spec.endswith(FLIPPED):
        cover = load_logo(scenes[0], CLOTHES)
        return open_pattern(spec, cover, scenes[0])[0], scenes[0]
    folder = run_path(spec)
    config = read_run(folder)
    fitting = [scene for scene in scenes if scene.topology == config["topology"]]
    bodies = fitting[0] if fitting else load_scene(kept_back("scene", config))
    return open_run(folder, config, None, bodies)[0], bodies


def rates(summary: dict, name: str) -> dict:
    """Pick the rates of one thing that is worn, by detector."""
    return {spec: {key: said[name][key] for key in RATES} for spec, said in summary["detectors"].items()}


def on_renders(
    pattern: Pattern, bodies: Bodies, backgrounds: Backgrounds, detectors: dict, controls: tuple[str, ...], out: Path
) -> dict[str, dict]:
    """Judge the logo, and controls, in every setting: by what is worn and by setting."""
    found = {what: {} for what in ("logo", *controls)}
    for name, (angles, changes) in RENDERS.items():
        settings = EvaluateSettings(images_per_view=1, controls=controls, bare=1, resamples=100, **changes)
        shown = OnBodies(bodies, backgrounds, angles).show(pattern, detectors, settings)
        summary = evaluate(shown, detectors, settings, out=out / "evaluation" if settings.cycles else None)
        for what, said in found.items():
            said[name] = rates(summary, what)
    return found


def means(textures: dict[str, dict], name: str, rate: str) -> np.ndarray:
    """Average over the detectors, of every texture in a setting of renders and on photographs: [textures, 2]."""
    mean = lambda seen: np.mean([said[rate] for said in seen.values()])
    return np.array([[mean(texture[name]), mean(texture["photographs"])] for texture in textures.values()])


def rank(textures: dict[str, dict], name: str, rate: str) -> dict:
    """Correlate a setting's ranks of the textures with those on photographs."""
    pairs = means(textures, name, rate)
    draws = np.random.default_rng(0).integers(len(pairs), size=(2000, len(pairs)))
    values = [spearmanr(*pairs[draw].T).statistic for draw in draws]
    spread = [round(float(x), 4) for x in np.nanquantile(values, (0.025, 0.975))]
    return {"spearman": round(float(spearmanr(*pairs.T).statistic), 4), "ci95": spread}


def main() -> None:
    """Measure every texture, then correlate."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("colors", nargs="+")
    parser.add_argument("--people", required=True)
    parser.add_argument("--scene", action="append", required=True)
    parser.add_argument("--detector", action="append", required=True)
    parser.add_argument("--backgrounds", default="procedural:test")
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    detectors = {spec: load_detector(spec) for spec in given.detector}
    scenes, backgrounds = [load_scene(scene) for scene in given.scene], load_backgrounds(given.backgrounds)
    given.out.mkdir(parents=True, exist_ok=True)
    seen = given.out / "photographs.json"
    if not seen.exists():
        write_json(seen, wear_and_judge(given.colors, cast_of(given.people), detectors, backgrounds))
    photographs, textures = read_json(seen), {}
    for number, spec in enumerate(given.colors):
        name, kept = open_pattern(spec)[2], given.out / f"{number}.json"
        if not kept.exists():
            worn = *opened(spec, scenes), backgrounds
            write_json(kept, on_renders(*worn, detectors, () if number else CONTROLS, given.out / str(number)))
        for what, said in read_json(kept).items():
            called = name if what == "logo" else what
            textures[called] = {"photographs": rates(photographs, called)} | said
            means = {key: np.mean([x["success"] for x in one.values()]) for key, one in textures[called].items()}
            print(called, {key: round(float(mean), 2) for key, mean in means.items()}, flush=True)
    ranks = {name: {rate: rank(textures, name, rate) for rate in RATES} for name in RENDERS}
    counts = {key: photographs[key] for key in ("people", "photographs")}
    write_json(given.out / "correlation.json", counts | {"rank": ranks, "textures": textures})
    for name, said in ranks.items():
        print(name, said)


if __name__ == "__main__":
    main()
