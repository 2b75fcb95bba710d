"""What commands print and write, held to the digit: a change of structure is to change none of it.

`CLOAK_WRITE_GOLDEN=1 pytest tests/golden -k photographs-` writes the figures of this group, or of any cases, anew into
golden.json, beside the seconds that each took, which are not compared. Only public commands are named. Sums differ in
their last bits from one processor to another, and twenty steps make much of that: where arithmetic is not that of the
machine that wrote the file, nothing can be compared, and the tests skip.
"""

import contextlib
import hashlib
import io
import json
import math
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from string import Formatter

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from cloak_core.cli import main
from cloak_core.studies.card import protocol

pytestmark = pytest.mark.long
GOLDEN = Path(__file__).with_name("golden.json")
WRITING = bool(os.environ.get("CLOAK_WRITE_GOLDEN"))
FIGURES, ROUGH = 1.5e-6, 1.5e-4
"""How far a figure may be off, relative where it is above 1; and one that is written with at most four digits."""
LEFT_OUT = ("seconds", "time", "versions", "ci95", "by_")
"""Beginnings of keys: times, how it was made, and what follows from the figures beside it."""

TINY = replace(protocol.QUICK, steps=6, front_step=20, images_per_view=1, clean_images=16, bare=8, people=4)
"""A quick card whose training is short enough to keep its digits."""
TRAIN = "train --steps 20 --out {out} --preview-every 0 --logo"
BUILTIN = "--detector builtin"
FASTESTDET = "--detector {shared}/data/detectors/fastestdet.onnx"
NANODET = "--detector {shared}/data/detectors/nanodet_m.onnx"
TCA, TCEGA = "{shared}/data/attacks/texture_tca.png", "{shared}/data/attacks/texture_tcega.png"
ON_PEOPLE = f"--people {{people}} {BUILTIN} {NANODET}"
FEW = "--most-images 16 --bare 8 --out {out}"
JUDGED = "--people {people} --bare 8 --out {out}"
HARDEN = "harden builtin --steps 3 --size 160 --batch 3 --attack-steps 4 --precision float32 --no-assess --out {out}"
RUN, CLOTH_RUN, FILM = "events.jsonl colors.npy", "events.jsonl colors.npy cloth.png", "film.json 00007.png"
# What a command is asked, and which of the files that it writes are summed up. {out}: a new path; {shared}, {people};
# {NAME}: the folder that case NAME wrote.
BODIES = {
    "paper": (f"{TRAIN} chest+thighs --preset paper", RUN),
    "reference": (f"{TRAIN} chest+thighs --preset reference", RUN),
    "best": (f"{TRAIN} chest+thighs", RUN),
    "transfer": (f"{TRAIN} shirt+trousers --preset transfer {BUILTIN} {FASTESTDET}", RUN),
    "patches": (f"{TRAIN} shirt+trousers --pattern camouflage --feature-cm 8", RUN),
    "cloth": (f"{TRAIN} shirt+trousers --pattern tile --tile-cm 25 --initial balls", CLOTH_RUN),
    "best_judged": (f"evaluate {{best}} --controls clothing grey random stripes checks {FEW}", ""),
    "patches_judged": (f"evaluate {{patches}} {FEW}", ""),
    "cloth_judged": (f"evaluate {{cloth}} --distances 2.2 5 {FEW}", ""),
    "print_judged": (f"evaluate {{best}} --colors print:balls@tile=0.25 {FEW}", ""),
    "picture_judged": (f"evaluate {{best}} --samples 4 --colors {TCA}@tile=0.25 {FEW}", ""),
    "card": ("assess builtin --quick --zoo builtin-sample --out {out}", ""),
    "film": ("film {best} --seconds 0.3 --camera orbit --out {out}", FILM),
    "film_of_cloth": ("film {cloth} --seconds 0.3 --out {out}", FILM),
    "matrix": (
        f"transfer {BUILTIN} {FASTESTDET} --steps 3 --batch 2 --images-per-view 1 --most-images 8 --out {{out}}",
        "",
    ),
    "harden": (HARDEN, "events.jsonl hardened.weights"),
    "look": ("look {best}.look", "cloak.png clothing.png"),
    "look_at_cloth": ("look {cloth}.look", "cloak.png"),
    "print": ("print {cloth} --dpi 20 --out {out}", "print.json cloak.png body.glb"),
    "glb": ("zoo export builtin-sample --format glb --dpi 20 --out {out}.glb", ".glb"),
}
PHOTOGRAPHS = {
    "photographs": (f"{TRAIN} shirt+trousers {ON_PEOPLE}", CLOTH_RUN),
    "faces": (f"{TRAIN} shirt+trousers {ON_PEOPLE} --pattern free", RUN),
    "both": (f"{TRAIN} shirt+trousers {ON_PEOPLE} --scene sample:train --people-share 0.5", CLOTH_RUN),
    "photographs_judged": (f"evaluate {{photographs}} {JUDGED}", ""),
    "faces_judged": (f"evaluate {{faces}} {JUDGED}", ""),
    "patch_judged": (f"evaluate {{best}} --colors {TCA}@patch=0.3 {JUDGED}", ""),
    "wear": (
        f"wear {{best}} zoo:transfer-people {TCEGA}@tile=0.25 {TCA}@patch=0.3 print:balls@tile=0.25 {ON_PEOPLE}"
        " --bare 2 --out {out}",
        "",
    ),
    "card_on_people": (
        f"assess builtin --quick --zoo builtin-sample --people {{people}} --patterns {TCA} --out {{out}}",
        "",
    ),
    "harden_on_people": (
        f"{HARDEN} --people {{people}} --people-share 0.6 --cloths 1",
        "events.jsonl hardened.weights",
    ),
}
GROUPS = {"bodies": BODIES, "photographs": PHOTOGRAPHS}
CASES = BODIES | PHOTOGRAPHS


class Made(dict):
    """What the cases wrote, by their names; a case is run when something asks for it first."""

    def __init__(self, folder: Path, shared: Callable[[], Path]) -> None:
        super().__init__()
        self.folder, self.find_shared, self.outcomes, self.seconds = folder, shared, {}, {}

    def __missing__(self, name: str) -> str:
        if name == "shared":
            self[name] = str(self.find_shared())
        elif name == "people":
            self[name] = f"{self['shared']}/data/people/people.json[0::40]"
        else:
            self[name] = self._run(name)
        return self[name]

    def _run(self, name: str) -> str:
        out, (words, files) = str(self.folder / name), CASES[name]
        given = {key: out if key == "out" else self[key] for _, key, _, _ in Formatter().parse(words) if key}
        if name.startswith("look"):
            run = next(iter(given.values()))
            asked = {"scene": "sample:unseen", "pose": 1, "azimuth": 20, "out": out, "cloth": run}
            Path(f"{run}.look").write_text(json.dumps(asked | {n: f"{run}/{n}.npy" for n in ("logo", "colors")}))
        begun = time.perf_counter()
        with contextlib.redirect_stdout(io.StringIO()) as printed, pytest.raises(SystemExit) as end:
            main([*words.format(**given).split(), "--json"])
        assert not end.value.code
        self.seconds[name] = round(time.perf_counter() - begun, 1)
        told = printed.getvalue().replace(str(self.folder), "made").replace(self.get("shared", "\0"), "shared")
        sums = {file: summary(Path(out + file if file == ".glb" else f"{out}/{file}")) for file in files.split()}
        self.outcomes[name] = {"printed": figures(json.loads(told))} | sums
        return out


def figures(value: object) -> object:
    """Keep the numbers of a record (and None, which says that there is none)."""
    if isinstance(value, dict):
        kept = {k: figures(v) for k, v in value.items() if not (isinstance(v, str) or k.startswith(LEFT_OUT))}
        return {k: v for k, v in kept.items() if k != "made" and v not in ({}, [])}
    if isinstance(value, list):
        return [figures(v) for v in value if not isinstance(v, str)]
    return round(value, 7) if isinstance(value, float) else value


def summary(path: Path) -> object:
    """Sum up a file: of a log its losses; of colours, a picture, weights or a body's texture the shape and means."""
    if path.suffix == ".json":
        return figures(json.loads(path.read_text()))
    if path.suffix == ".jsonl":
        steps = [figures(event) for event in map(json.loads, path.read_text().splitlines()) if event["type"] == "step"]
        return {key: [step[key] for step in steps] for key in steps[0]}
    if path.suffix == ".npy":
        return means(np.load(path), 7)
    if path.suffix == ".weights":
        return means(np.fromfile(path, np.float32)[5:], 7)
    if path.suffix == ".glb":
        (mesh,) = trimesh.load(path).geometry.values()
        picture = np.asarray(mesh.visual.material.baseColorTexture.convert("RGB")) / 255
        return {"vertices": means(mesh.vertices), "uv": means(mesh.visual.uv), "picture": means(picture)}
    with Image.open(path) as picture:
        return means(np.asarray(picture.convert("RGB")) / 255)


def means(values: np.ndarray, digits: int = 4) -> dict:
    """Compute the means of twelve equal parts; what is stored in 8 bits has four digits."""
    flat = values.reshape(-1).astype(np.float64)
    parts = [round(float(part.mean()), digits) for part in np.array_split(flat, 12)]
    return {"shape": list(values.shape), "deviation": round(float(flat.std()), digits), "means": parts}


def differences(golden: object, now: object, place: str = "") -> Iterator[str]:
    """Say what is missing or another figure; what is new is no difference."""
    if isinstance(golden, dict) and isinstance(now, dict):
        for key, value in golden.items():
            yield from differences(value, now.get(key, "missing"), f"{place}/{key}")
    elif isinstance(golden, list) and isinstance(now, list) and len(golden) == len(now):
        for i, (one, other) in enumerate(zip(golden, now, strict=True)):
            yield from differences(one, other, f"{place}[{i}]")
    elif not _same(golden, now):
        yield f"{place}: {golden}, now {now}"


def _same(golden: object, now: object) -> bool:
    if not (isinstance(golden, float) and isinstance(now, int | float)):
        return golden == now
    near = ROUGH if round(golden, 4) == golden else FIGURES
    return math.isclose(golden, now, rel_tol=near, abs_tol=near)


def arithmetic() -> str:
    """Digest what this machine makes of plain sums in float32, on one thread."""
    image = torch.linspace(-1, 1, 3 * 64 * 64).reshape(1, 3, 64, 64).requires_grad_()
    weight = torch.linspace(-3, 3, 32 * 27).sin().reshape(32, 3, 3, 3)
    maps = torch.nn.functional.conv2d(image, weight, padding=1).sigmoid().flatten(2)[0]
    (maps @ maps.T).logsumexp(0).sum().backward()
    return hashlib.sha256(image.grad.numpy().tobytes()).hexdigest()[:16]


def one_case_a_line(golden: dict) -> str:
    """Write JSON whose diff names the cases that changed."""
    groups = {
        group: "{\n" + ",\n".join(f"{json.dumps(name)}: {json.dumps(case)}" for name, case in cases.items()) + "\n}"
        for group, cases in golden["cases"].items()
    }
    cases = ",\n".join(f"{json.dumps(group)}: {lines}" for group, lines in groups.items())
    rest = ",\n".join(f"{json.dumps(key)}: {json.dumps(golden[key])}" for key in ("arithmetic", "seconds"))
    return f'{{{rest},\n"cases": {{\n{cases}\n}}}}\n'


@pytest.fixture(scope="module")
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Made]:
    """Run cases on one thread, with a card of few images."""
    before, folder = torch.get_num_threads(), tmp_path_factory.mktemp("golden")
    torch.set_num_threads(1)
    if not WRITING and json.loads(GOLDEN.read_text())["arithmetic"] != arithmetic():
        pytest.skip("golden.json was written on a machine whose sums differ in their last bits")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CLOAK_CACHE", str(folder / "cache"))
        patch.setitem(protocol.SIZES, "quick", TINY)
        yield Made(folder, lambda: request.getfixturevalue("shared"))
    torch.set_num_threads(before)


@pytest.mark.parametrize(("group", "name"), [(group, name) for group, cases in GROUPS.items() for name in cases])
def test_figures_are_what_they_were(group: str, name: str, made: Made) -> None:
    _ = made[name]
    golden = json.loads(GOLDEN.read_text())
    if WRITING:
        golden["arithmetic"] = arithmetic()
        golden["seconds"][name] = made.seconds[name]
        golden["cases"][group][name] = made.outcomes[name]
        GOLDEN.write_text(one_case_a_line(golden))
    assert list(differences(golden["cases"][group][name], made.outcomes[name])) == []
