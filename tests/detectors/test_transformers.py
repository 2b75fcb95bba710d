"""The DETR family on small random models, against the library itself."""

from pathlib import Path

import numpy as np
import pytest
import torch

from cloak_core.core.detector.protocol import state_hash
from cloak_core.detectors.loading import load_detector
from cloak_core.files.errors import InputError
from tests.detectors.helpers import images, lowers_score, others_are_the_rest

transformers = pytest.importorskip("transformers", reason="pip install 'cloak-core[transformers]'")

LABELS = {0: "cat", 1: "Person", 2: "dog"}
SMALL = {
    "d_model": 32,
    "decoder_layers": 2,
    "encoder_ffn_dim": 32,
    "decoder_ffn_dim": 32,
    "encoder_attention_heads": 2,
    "decoder_attention_heads": 2,
    "num_queries": 10,
    "id2label": LABELS,
}
RESNET = {"embedding_size": 8, "hidden_sizes": [8, 8, 16, 16], "depths": [1, 1, 1, 1]}
STAGES = ["stage2", "stage3", "stage4"]


def config(name: str):
    if name == "Yolos":
        sizes = {"hidden_size": 32, "num_hidden_layers": 2, "num_attention_heads": 2, "intermediate_size": 32}
        return transformers.YolosConfig(image_size=[64, 96], num_detection_tokens=10, id2label=LABELS, **sizes)
    make = getattr(transformers, f"{name}Config")
    if name.endswith("Detr") and not name.startswith("RT"):
        backbone = transformers.ResNetConfig(**RESNET, out_features=STAGES if name == "DeformableDetr" else STAGES[2:])
        more = {"num_feature_levels": 3} if name == "DeformableDetr" else {}
        return make(backbone_config=backbone, use_timm_backbone=False, encoder_layers=1, **SMALL, **more)
    backbone = transformers.RTDetrResNetConfig(**RESNET, layer_type="basic", out_features=STAGES)
    channels = {"encoder_in_channels": [8, 16, 16], "encoder_hidden_dim": 32, "decoder_in_channels": [32, 32, 32]}
    points = [4, 4, 4] if name == "DFine" else 4
    return make(backbone_config=backbone, decoder_n_points=points, hidden_expansion=0.5, **SMALL, **channels)


def has_statistics(module: torch.nn.Module) -> bool:
    return hasattr(module, "running_var")


NAMES = ("Detr", "ConditionalDetr", "DeformableDetr", "RTDetr", "RTDetrV2", "DFine", "Yolos")


def save(name: str, folder: Path):
    with torch.random.fork_rng():
        torch.manual_seed(3)
        model = getattr(transformers, f"{name}ForObjectDetection")(config(name)).eval()
        with torch.no_grad():
            for parameter in model.parameters():  # as the library draws them the image hardly matters
                if parameter.dim() > 1:
                    parameter.mul_(3 if name == "Yolos" else 1.5)
            for module in filter(has_statistics, model.modules()):  # that fold into the convolutions before them
                module.running_mean.uniform_(-0.2, 0.2)
                module.running_var.uniform_(0.5, 1.5)
    model.save_pretrained(folder)
    return model


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_equals_the_library(name: str, tmp_path: Path) -> None:
    model = save(name, tmp_path)
    detector = load_detector(f"transformers:{tmp_path}@64x96")
    assert not detector.training and not [p for p in detector.parameters() if p.requires_grad]
    assert not [*filter(has_statistics, detector.modules())] and (
        name == "Yolos" or [*filter(has_statistics, model.modules())]
    )
    batch = images(2, 64, 96, seed=2)
    pixels = detector.preprocessing(batch)
    with torch.no_grad():
        theirs, found = model(pixel_values=pixels), detector(batch)
        torch.testing.assert_close(detector.model(pixel_values=pixels).logits, theirs.logits)
    softmax = theirs.logits.shape[-1] == 4
    expected = theirs.logits.softmax(-1)[..., 1] if softmax else theirs.logits.sigmoid()[..., 1]
    torch.testing.assert_close(found.scores, expected)
    x, y, w, h = theirs.pred_boxes.unbind(-1)
    by_hand = torch.stack([(x - w / 2) * 96, (y - h / 2) * 64, (x + w / 2) * 96, (y + h / 2) * 64], dim=-1)
    torch.testing.assert_close(found.boxes, by_hand)


@pytest.mark.long
@pytest.mark.parametrize("name", ["Detr", "RTDetr"])
def test_tells_the_best_other_class(name: str, tmp_path: Path) -> None:
    save(name, tmp_path)

    def load(number: int):
        return load_detector(f"transformers:{tmp_path}@64x96,person={number}")

    assert load(1).class_names == ("cat", "Person", "dog")
    others_are_the_rest(load, 3, 1, images(2, 64, 96, seed=2))


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_a_gradient_step_lowers_the_score(name: str, tmp_path: Path) -> None:
    """As the model is, and fully fooled."""
    save(name, tmp_path)
    detector = load_detector(f"transformers:{tmp_path}@64x96").double()
    before_hash = state_hash(detector)
    before, after = lowers_score(detector, images(2, 64, 96).double())
    assert bool((after < before).all()) and state_hash(detector) == before_hash
    for parameter, values in detector.model.named_parameters():
        if values.dim() == 1 and len(values) in (3, 4) and "class" in parameter:
            values[detector.person] -= 15
    before, after = lowers_score(detector, images(2, 64, 96).double())
    assert before.max() < 1e-3 and bool((after < before).all())


@pytest.mark.slow
def test_preprocessing_equals_the_image_processor(tmp_path: Path) -> None:
    save("Detr", tmp_path)
    processor = transformers.DetrImageProcessor(size={"shortest_edge": 80, "longest_edge": 110}, do_pad=False)
    processor.save_pretrained(tmp_path)
    detector = load_detector(f"transformers:{tmp_path}")
    picture = (images(1, 120, 200)[0] * 255).round().to(torch.uint8)
    theirs = processor(picture, return_tensors="pt")["pixel_values"]
    ours = detector.preprocessing(picture[None].float() / 255)
    assert ours.shape == theirs.shape
    assert np.abs((ours - theirs).numpy()).max() < 0.02  # the library rounds to whole grey levels after resizing


def test_incomplete_weights_and_missing_person(tmp_path: Path) -> None:
    model = save("Yolos", tmp_path)
    with pytest.raises(InputError, match="no class 'horse' among its 3"):
        load_detector(f"transformers:{tmp_path}@person=horse")
    state = model.state_dict()
    removed = next(name for name in state if "class_labels" in name)
    del state[removed]
    model.save_pretrained(tmp_path, state_dict=state)
    with pytest.raises(InputError, match=r"lack 1 of the model's tensors \(class_labels"):
        load_detector(f"transformers:{tmp_path}")
