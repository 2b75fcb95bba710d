"""Commands that pages show: every one is understood, and most are run, with reduced counts, one after the other."""

import os
import shutil
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from PIL import Image

from cloak_core.cli import COMMANDS, find, load, main
from cloak_core.commands import parsing
from cloak_core.exchange.profiles import Profile, write_profile
from cloak_core.exchange.scenes import write_scene
from cloak_core.products import print_sheets
from cloak_core.sources.bodies.people.samples import sample_bodies
from tests.docs.blocks import PAGES, REPORTS, ROOT, commands, words
from tests.schemas import SCHEMAS, validate

LOOK = {"size": "96", "samples": "1", "threads": "1"}
REDUCED = {
    "train": LOOK | {"steps": "2", "batch": "2", "translation": "4", "preview-every": "0", "snapshot-every": "1"},
    "evaluate": LOOK | {"most-images": "4", "images-per-view": "1", "bare": "1", "resamples": "100", "shift": "4"},
    "film": LOOK | {"fps": "2", "seconds": "1"},
    "export coco": {"size": "96", "shift": "4", "angles": "0", "images-per-view": "1", "most-images": "2"},
    "logo heatmap": {"angles": "0", "threads": "1"},
    "detectors verify": {"renders": "2", "threads": "1"},
    "print": {"dpi": "20"},
    "zoo export": {"dpi": "20"},
    "judge": {"every": "50", "resamples": "100", "threads": "1"},
    "sweep": {"threads": "1"},
    "zoo reproduce": {"most-images": "2", "threads": "1"},
}
"""Options that take the place of those that a page shows, and their values."""
LONG = {"assess", "demo", "harden", "reproduce", "transfer"}
NOT_RUN = {
    "minutes of training at the least": lambda c: c[0] in LONG,
    "needs cards, and is in tests/studies": lambda c: c[0] == "leaderboard",
    "measures for minutes": lambda c: c[0] == "bench",
    "samples every pose, distance and background": lambda c: c[:2] == ["detectors", "check"] and "--scene" in c,
    "needs a cluster, and is in tests/jobs": lambda c: "--ray" in c,
    "renders in Cycles, and is in tests/studies": lambda c: "--cycles" in c,
    "thousands of questions to a detector": lambda c: "--black-box-queries" in c or "REFINED" in c,
    "colours of the reader's": lambda c: "FILE.npy" in c or "zoo:NAME" in c,
    "needs photographs of a printed chart": lambda c: "--measured" in c or "PRINTED" in " ".join(c) or "AGAIN" in c,
    "needs a body with a UV map": lambda c: "texture.png" in c or "--pieces" in c,
    "needs a list of pictures and boxes": lambda c: "--boxes" in c,
    "needs photographs of people": lambda c: "--people" in c,
    "needs files of the reader's": lambda c: any(
        word.split("@")[0].endswith((".obj", ".pkl", ".xml", ".tflite", "camouflage.png")) for word in c
    ),
}
"""Why a command is understood but not run here; the first that holds."""
NETS = {
    "a": "yolo-lite-coco-trial6",
    "yolov2": "yolo-lite-coco-trial6",
    "XL": "yolo-fastest-1.1-xl",
}
SPECS = {"A": "builtin", "B": "darknet:a.cfg:a.weights@96", "C": "builtin@64", "D": "builtin@128", "SPEC": "builtin"}


@pytest.fixture(autouse=True)
def few_sheets(monkeypatch: pytest.MonkeyPatch) -> None:
    """A cloak over shirt and trousers takes a hundred sheets; two are enough here."""
    cut = print_sheets.tiles
    monkeypatch.setattr(print_sheets, "tiles", lambda *how: cut(*how)[:2])


def why_not(command: list[str]) -> str | None:
    return next((why for why, holds in NOT_RUN.items() if holds(command)), None)


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES + REPORTS, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_command_of_a_page_is_understood(page: Path) -> None:
    """Options that no longer exist, or lack what they need, are InputErrors."""
    for command in commands(page):
        name, options = find(command)
        needed = elided(name, options)
        assert isinstance(parsing.parse(load(name), name, options + needed), load(name)), command


def elided(name: str, options: list[str]) -> list[str]:
    """What `...` stands for in `cloak train --palette FILE ...`: the options that a command cannot do without."""
    logo = "worn.npy" if any(word.startswith("zoo:") for word in options) else "chest.npy"
    needed = {"scene": "sample:train[0:2]", "logo": logo, "out": "NEW"} if name == "train" else {}
    return [word for key, value in needed.items() if f"--{key}" not in options for word in (f"--{key}", value)]


@pytest.fixture(scope="module")
def desk(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the pages' names stand for."""
    folder, data = tmp_path_factory.mktemp("desk"), shared / "data"
    for stand_in, name in NETS.items():
        (folder / f"{stand_in}.cfg").symlink_to(data / "weights" / f"{name}.cfg")
        (weights,) = data.glob(f"weights/{name}*.weights")
        (folder / f"{stand_in}.weights").symlink_to(weights)
    for name in ("net", "nanodet_m", "yolov8n"):
        (folder / f"{name}.onnx").symlink_to(data / "detectors" / "fastestdet.onnx")
    (folder / "HARD").mkdir()
    (folder / "HARD" / "hardened.onnx").symlink_to(data / "detectors" / "fastestdet.onnx")
    (folder / "bodies_anny.npz").symlink_to(data / "bodies_anny.npz")
    for name in ("photo.jpg", "person.jpg"):
        shutil.copy(data / "photos" / "person.jpg", folder / name)
    (folder / "photos").mkdir()
    shutil.copy(data / "photos" / "person.jpg", folder / "photos")
    (folder / "docs" / "images").mkdir(parents=True)
    for name in ("PHOTOS", "STAND-INS"):
        (folder / name).mkdir()
        for sort in ("with", "without"):
            (folder / name / sort).mkdir()
            shutil.copy(data / "photos" / "person.jpg", folder / name / sort / "ann.jpg")
    noise = np.random.default_rng(0)
    for name in ("DIR", "DIR2", "OTHERS", "backgrounds", "BACKGROUNDS"):
        (folder / name).mkdir()
        for i in range(4):
            Image.fromarray(noise.integers(0, 255, (120, 120, 3), np.uint8)).save(folder / name / f"{i}.png")
    train, unseen = sample_bodies("train").select_poses([0, 9]), sample_bodies("unseen").select_poses([0])
    for name, bodies in {
        "SCENE": train,
        "SCENE_A": train,
        "SCENE_B": unseen,
        "UNSEEN": unseen,
        "MOTION": unseen,
    }.items():
        write_scene(folder / name, bodies)
    (folder / "MOTIONS").symlink_to("MOTION")
    write_profile(folder / "printer.npz", Profile(np.stack(np.meshgrid(*[[0.1, 0.9]] * 3, indexing="ij"), -1)))
    (folder / "cloths.txt").write_text("".join(f"{x} {x} {1 - x}\n" for x in np.linspace(0, 1, 10)), "utf-8")
    (folder / "grid.toml").write_text('[base]\nscene = "SCENE"\nlogo = "chest.npy"\nsteps = 1\n[grid]\nseed = [0, 1]\n')
    (folder / "examples").symlink_to(ROOT / "examples")
    (folder / "mine.py").symlink_to(ROOT / "examples" / "my_detector.py")
    run_there(folder, words("cloak logo select --scene SCENE --region chest+thighs --out chest.npy")[1:])
    run_there(folder, words("cloak logo select --scene sample:train --region shirt+trousers --out worn.npy")[1:])
    run_there(folder, words("cloak logo select --scene bodies_anny.npz --region shirt_trousers --out shirt.npy")[1:])
    for name in ("ct.npy", "a.npy"):
        for end in (".npy", ".json"):
            shutil.copy(folder / f"chest{end}", (folder / name).with_suffix("").with_name(Path(name).stem + end))
    shutil.copy(folder / "chest.npy", folder / "LOGO")
    run_there(folder, reduced(words("cloak train --scene sample:train[0:2] --logo chest.npy --out RUN")[1:]))
    for name in ("free", "k8", "through"):
        (folder / name).symlink_to("RUN")
    return folder


def reduced(command: list[str]) -> list[str]:
    """The command with small counts, and detectors that there are."""
    name, options = find(command)
    changes, kept = dict(REDUCED.get(name, {})), []
    if name == "zoo export" and "glb" not in options:
        changes = {}
    skipping = False
    for word in options:
        if word.startswith("--"):
            skipping = word[2:] in changes
        if not skipping:
            before = kept[-1] if kept else ""
            kept.append(SPECS.get(word, word) if before in ("--detector", "--judge") else word)
    kept += elided(name, options)
    return [*name.split(), *kept, *(word for key, value in changes.items() for word in (f"--{key}", value))]


def run_there(folder: Path, command: list[str]) -> None:
    """Run in a folder; what an earlier command wrote there makes room."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        if "--out" in command and "--resume" not in command:
            out = Path(command[command.index("--out") + 1])
            if out.is_symlink() or out.is_file():
                out.unlink()
            elif out.is_dir():
                shutil.rmtree(out)
        with pytest.raises(SystemExit) as end:
            main(command)
        assert not end.value.code, command
    finally:
        os.chdir(before)


@pytest.mark.long
@pytest.mark.parametrize("page", [p for p in PAGES if commands(p)], ids=lambda page: page.relative_to(ROOT).as_posix())
def test_the_commands_of_a_page_run(page: Path, desk: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """On a copy of the desk, so that pages do not meet; what --json prints is what the schemas promise."""
    shutil.copytree(desk, tmp_path / "desk", symlinks=True)
    for command in commands(page):
        if why_not(command):
            continue
        capsys.readouterr()
        try:
            run_there(tmp_path / "desk", reduced(command))
            if "--json" in command and find(command)[0] in SCHEMAS["commands"]:
                validate(find(command)[0], capsys.readouterr().out)
        except BaseException:
            print(f"in {page}: cloak {' '.join(command)}")
            raise


PRINTED = [
    "scene info SCENE",
    "logo select --scene SCENE --region chest --out small.npy",
    "train --scene SCENE --logo chest.npy --backgrounds DIR --out NEW",
    "evaluate RUN --scene UNSEEN --backgrounds DIR2",
    "detectors check builtin --image photo.jpg",
    "detectors verify builtin",
    "report RUN",
    "scene sample --out SAMPLES",
    "logo project --scene SCENE --text G --out letter.npy",
    "logo heatmap --scene SCENE --detector builtin --out heat.npy --pick 0.2",
    "logo transfer --from SCENE --to UNSEEN --logo chest.npy --out moved.npy",
    "print zoo:builtin-sample --out SHEETS",
    "sweep grid.toml --out SWEEP",
    "export coco RUN --scene UNSEEN --backgrounds DIR2 --out DATA",
    "detectors list",
    "zoo list",
    "zoo show builtin-sample",
    "zoo reproduce builtin-sample",
    "zoo export builtin-sample --out ENTRY",
    "version",
    "setup",
    "completion bash",
    "film RUN --scene UNSEEN --out film.gif",
    "judge PHOTOS --detector builtin",
]
ELSEWHERE = {
    "assess",
    "leaderboard add",
    "leaderboard build",
    "harden",
    "transfer",
    "calibrate",
    "look",
    "wear",
    "people fit",
}
"""Too long here; held against their schemas in tests/studies, tests/commands and tests/products."""
NOT_HELD = {"demo", "reproduce", "scene import", "scene import-smpl", "scene import-anny", "zoo add", "remote"}
"""Their schemas are read by people alone, like those of what measures (bench ...)."""


@pytest.mark.long
def test_what_json_prints_is_what_the_schemas_say(desk: Path, capsys: pytest.CaptureFixture) -> None:
    lines = [line.split() for line in PRINTED]
    long_ones = {name for name in COMMANDS if name.startswith("bench ")}
    assert {find(line)[0] for line in lines} | ELSEWHERE | NOT_HELD | long_ones == set(COMMANDS)
    for line in lines:
        capsys.readouterr()
        run_there(desk, [*reduced(line), "--json"])
        validate(find(line)[0], capsys.readouterr().out)
    with pytest.raises(jsonschema.ValidationError):
        validate("scene info", '{"poses": "two"}')


def test_every_command_has_a_schema() -> None:
    assert SCHEMAS["commands"] == list(COMMANDS) and set(COMMANDS) <= set(SCHEMAS["$defs"])
    for schema in SCHEMAS["$defs"].values():
        jsonschema.Draft202012Validator.check_schema(schema)


def test_most_commands_are_run_and_every_excuse_is_needed() -> None:
    shown = [command for page in PAGES for command in commands(page)]
    excused = [why for command in shown if (why := why_not(command))]
    assert set(excused) == set(NOT_RUN)
    assert len(excused) < 0.45 * len(shown), f"{len(excused)} of {len(shown)} commands are not run"
