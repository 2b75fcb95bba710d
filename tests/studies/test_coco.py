"""The data set is what others' readers take it for: pycocotools and torchvision."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from pycocotools.coco import COCO
from torchvision.datasets import CocoDetection

from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.images import ImageSet
from cloak_core.core.logo import load_logo
from cloak_core.exchange.face_lists import write_colors
from cloak_core.patterns.faces import FacePattern
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.studies.coco import export_coco, run_lengths
from cloak_core.studies.imagery import drawn_images

SIZE = 64


@pytest.fixture(scope="module")
def red() -> FacePattern:
    logo = load_logo(sample_bodies("unseen"), region="chest")
    return FacePattern(logo, colors=np.tile(np.array([[1, 0, 0]], np.float32), (len(logo), 1)))


@pytest.fixture(scope="module")
def shown(red: FacePattern) -> ImageSet:
    bodies = sample_bodies("unseen").select_poses([0, 3])
    settings = EvaluateSettings(images_per_view=1, size=SIZE, shift=12, distances=(1.2, 2.2), samples=1)
    return drawn_images(bodies, load_backgrounds("procedural:test:3"), (-10.0, 90.0), settings, "cpu", [red])


@pytest.fixture(scope="module")
def made(shown: ImageSet, red: FacePattern, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("coco") / "set"
    told = export_coco(shown, red, out, "png")
    assert told["images"] == 2 * len(shown.trials) == 16 and told["cloaked"] == 8
    return out


def test_pycocotools_reads_boxes_masks_and_pairs(made: Path, shown: ImageSet, red: FacePattern) -> None:
    coco = COCO(made / "annotations.json")
    assert coco.loadCats(coco.getCatIds())[0]["name"] == "person"
    pairs: dict[int, list] = {}
    for number in coco.getImgIds():
        image, (found,) = coco.loadImgs(number)[0], coco.loadAnns(coco.getAnnIds(number))
        mask = coco.annToMask(found).astype(bool)
        assert mask.shape == (SIZE, SIZE) and mask.sum() == found["area"]
        y, x = np.nonzero(mask)
        box = [x.min(), y.min(), x.max() - x.min() + 1, y.max() - y.min() + 1]
        assert found["bbox"] == box
        true = shown.boxes(shown.views([image["pair"]], red), [image["pair"]])[0].tolist()
        assert [*box[:2], box[0] + box[2], box[1] + box[3]] == pytest.approx(true)
        pairs.setdefault(image["pair"], []).append((image, found))
    for trial, ((_, own), (_, worn)) in pairs.items():
        assert not own["attributes"]["cloaked"] and worn["attributes"]["cloaked"]
        assert own["bbox"] == worn["bbox"] and own["segmentation"] == worn["segmentation"]
        assert own["attributes"]["body"] == shown.body_names[shown.trials.at[trial, "pose"]]


def test_the_visible_box_is_what_the_border_leaves_of_the_whole_one(made: Path) -> None:
    found = json.loads((made / "annotations.json").read_text())["annotations"]
    assert {a["attributes"]["visible"] < 0.9 for a in found} == {True, False}
    for a in found:
        x, y, w, h = a["bbox_full"]
        clipped = [max(x, 0), max(y, 0), min(x + w, SIZE), min(y + h, SIZE)]
        seen = [*a["bbox"][:2], a["bbox"][0] + a["bbox"][2], a["bbox"][1] + a["bbox"][3]]
        if a["attributes"]["visible"] > 0.9:
            assert seen == pytest.approx(clipped, abs=1.5)  # a pixel counts where half of it is covered


def test_torchvision_reads_what_was_rendered(made: Path, shown: ImageSet, red: FacePattern) -> None:
    data = CocoDetection(str(made / "images"), str(made / "annotations.json"))
    assert len(data) == 16
    assert data[0][1][0]["category_id"] == 1 and len(data[0][1]) == 1
    images = data.coco.loadImgs(data.ids)
    first = {image["cloaked"]: k for k, image in enumerate(images) if image["pair"] == 0}
    own, worn = (np.asarray(data[first[cloaked]][0], float) for cloaked in (False, True))
    rendered = shown.render([0], red)[0].permute(1, 2, 0) * 255
    assert torch.equal(torch.from_numpy(worn), rendered.round().double())
    inside = data.coco.annToMask(data[first[True]][1][0]).astype(bool)
    assert np.abs(own - worn)[inside].mean() > 1 > np.abs(own - worn)[~inside].mean()


@pytest.mark.parametrize("seed", range(4))
def test_run_lengths_are_those_of_pycocotools(seed: int) -> None:
    from pycocotools import mask as masks

    mask = np.random.default_rng(seed).random((7, 5)) < 0.5
    packed = masks.frPyObjects({"size": [7, 5], "counts": run_lengths(mask)}, 7, 5)
    assert np.array_equal(masks.decode(packed), mask)


def test_the_command_takes_a_run_and_overwrites_nothing(red: FacePattern, tmp_path: Path, cloak) -> None:
    run = tmp_path / "run"
    run.mkdir()
    inputs = {"scene": "sample:train", "backgrounds": "procedural:train"}
    (run / "config.json").write_text(json.dumps({"inputs": inputs, "detectors": [{"spec": "builtin"}]}))
    write_colors(run / "colors.npy", red.colors)
    np.save(run / "logo.npy", red.cover.face_ids)
    asked = ["export", "coco", run, "--out", tmp_path / "out", "--json", "--size", "48", "--angles", "0"]
    asked += ["--backgrounds", "procedural:test:2", "--scene", "sample:unseen[0:1]"]
    code, out, _ = cloak(*asked)
    told = json.loads(out)
    assert code == 0 and told["images"] == 2 and len(COCO(told["file"]).imgs) == 2
    code, _, err = cloak(*asked)
    assert code == 2 and "exists already" in err
