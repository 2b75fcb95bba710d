"""Every family's file where the wheel alone is installed: one line each, none a traceback."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from cloak_core.detectors.families import FAMILIES
from cloak_core.detectors.naming import behind_defences, full_spec

ALONE = """
import importlib.metadata as metadata, json, re, sys
from importlib.machinery import PathFinder

def needed(name, known):
    if name not in known:
        known.add(name)
        try:
            lines = metadata.requires(name) or []
        except metadata.PackageNotFoundError:  # of another system
            return known
        for line in lines:
            if "extra ==" not in line:
                needed(re.match(r"[\\w.-]+", line)[0].lower().replace("_", "-"), known)
    return known

there, own = {}, needed("cloak-core", set())
for module, names in metadata.packages_distributions().items():
    there[module] = any(name.lower().replace("_", "-") in own for name in names)

class Alone:
    def find_spec(self, name, path=None, target=None):
        return PathFinder.find_spec(name, path, target) if there.get(name.partition(".")[0], True) else None
    def find_distributions(self, *context):
        return PathFinder.find_distributions(*context)
    def invalidate_caches(self):
        PathFinder.invalidate_caches()

sys.meta_path[sys.meta_path.index(PathFinder)] = Alone()
from cloak_core import cli
for words in json.loads(sys.argv[1]):
    try:
        cli.main(words)
        code = 0
    except SystemExit as end:
        code = end.code or 0
    print(f"code {code}", file=sys.stderr, flush=True)
"""


LACKING = {
    "yolov5n.pt": "ultralytics",
    "jpeg=75:ultralytics:yolov8n.yaml": "ultralytics",
    "a.onnx": "onnx",
    "shop.xml": "openvino",
    "pose.tflite": "tflite",
    "transformers:model": "transformers",
}
"""Specs, and the extra that each needs."""
OTHERS = ("net.cfg", "net.weights", "builtin:net.weights", "torchvision:ssd300_vgg16:a.pth", "python:own.py:load")


@pytest.mark.slow
def test_every_family_says_its_line(tmp_path: Path) -> None:
    families = {behind_defences(full_spec(spec)).family for spec in (*LACKING, *OTHERS[2:], "darknet:a.cfg:a.weights")}
    assert families == set(FAMILIES) and set(LACKING.values()) == {f.extra for f in FAMILIES.values()} - {""}
    Image.new("RGB", (32, 32)).save(tmp_path / "grey.png")
    (tmp_path / "model").mkdir()
    for name in ("yolov5n.pt", "a.onnx", "shop.xml", "pose.tflite", "net.cfg", "net.weights", "a.pth", "own.py"):
        (tmp_path / name).touch()
    commands = [["detectors", "check", spec, "--image", "grey.png"] for spec in (*LACKING, *OTHERS)]
    commands += [["train", "--logo", "chest", "--detector", spec, "--out", "RUN"] for spec in LACKING]
    commands += [["harden", spec, "--out", "NEW"] for spec in ("yolov5n.pt", "a.onnx", OTHERS[2], OTHERS[3])]
    commands += [["scene", "info", "anny:1"], ["film", "zoo:builtin-sample", "--out", "a.mp4"]]
    words = [sys.executable, "-c", ALONE, json.dumps(commands)]
    printed = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False).stderr
    answers = printed.split("code 2\n")
    assert len(answers) == len(commands) + 1 and "Traceback" not in printed, printed
    lacking = LACKING | {"anny:1": "anny", "a.mp4": "film"}
    for command, answer in zip(commands, answers, strict=False):
        assert answer.count("cloak: ") == 1, (command, answer)
        extra = next((lacking[word] for word in command if word in lacking), "")
        assert not extra or f"pip install 'cloak-core[{extra}]'" in answer.replace("\n", " "), answer
