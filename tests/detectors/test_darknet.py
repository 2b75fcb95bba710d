"""The Darknet reader against what Darknet itself computed, and against bad files."""

import struct
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from cloak_core.detectors.darknet.cfg import parse_cfg, read_cfg
from cloak_core.detectors.darknet.layers import reorg
from cloak_core.detectors.darknet.network import Network, build_network
from cloak_core.detectors.darknet.weights import read_weights, stored_tensors, write_darknet
from cloak_core.detectors.loading import load_detector
from cloak_core.files.errors import InputError
from tests.detectors.helpers import TINY_CFG, images, others_are_the_rest, write_tiny

GOLDEN = Path(__file__).parent / "golden"


@pytest.mark.parametrize(("name", "revision"), [("yolov4-parts", 5), ("yolov2-parts", 0)])
@pytest.mark.parametrize("folded", [False, True])
def test_equals_darknet_itself(name: str, revision: int, folded: bool, tmp_path: Path) -> None:
    network = Network(read_cfg(GOLDEN / f"{name}.cfg"))
    image = seeded_inputs(network, tmp_path / "seeded.weights", revision)
    read_weights(network, tmp_path / "seeded.weights").eval()
    if folded:
        network.fold()
    golden = np.load(GOLDEN / f"{name}.npz", allow_pickle=False)
    with torch.no_grad():
        maps = network(image[None])
    assert len(maps) == len(golden.files)
    for index, (head, raw) in enumerate(zip(network.heads, maps, strict=True)):
        ours, theirs = torch.cat(head.activate(head.split(raw)), 2)[0].flatten(0, 1).numpy(), golden[f"head_{index}"]
        assert np.abs(ours - theirs).max() <= 1e-5 * np.abs(theirs).max()


def test_tells_the_best_other_class(tmp_path: Path) -> None:
    cfg = TINY_CFG.replace("filters=12", "filters=16").replace("classes=1", "classes=3")
    spec = write_tiny(tmp_path, cfg, names=("cat", "person", "dog"))
    assert load_detector(spec).class_names == ("cat", "person", "dog")
    others_are_the_rest(lambda number: load_detector(f"{spec}@person={number}"), 3, 1, images(2, 96, 80))


def test_reorg_equals_darknets_loops() -> None:
    channels, height, width, stride = 8, 4, 6, 2
    x = np.arange(channels * height * width, dtype=np.float32)
    out = np.empty_like(x)
    for k in range(channels):
        for j in range(height):
            for i in range(width):
                part, block = k % (channels // stride**2), k // (channels // stride**2)
                column, row = i * stride + block % stride, j * stride + block // stride
                out[i + width * (j + height * k)] = x[column + width * stride * (row + height * stride * part)]
    ours = reorg(torch.from_numpy(x).view(1, channels, height, width), stride)
    assert torch.equal(ours, torch.from_numpy(out).view(1, channels * 4, height // 2, width // 2))


def test_yolo_boxes_by_hand() -> None:
    text = (
        "[net]\nwidth=64\nheight=32\n[convolutional]\nfilters=7\nsize=1\n"
        "[yolo]\nmask=1\nanchors=1,1, 10,20\nclasses=2\nnum=2\nscale_x_y=1.2"
    )
    network = build_network(text)
    raw = torch.zeros(1, 7, 4, 8)
    raw[0, :, 2, 3] = torch.tensor([1.0, 0.0, 0.0, np.log(2.0), -1.0, 2.0, 0.0])
    boxes, classes, objectness = network.heads[0].decode(raw, network.input_size)
    cell = 2 * 8 + 3
    x = (3 + 1.2 / (1 + np.exp(-1.0)) - 0.1) / 8
    assert boxes[0, cell].tolist() == pytest.approx(
        [x - 5 / 64, 2.5 / 4 - 20 / 32, x + 5 / 64, 2.5 / 4 + 20 / 32], abs=1e-6
    )
    assert objectness[0, cell].item() == pytest.approx(1 / (1 + np.e))
    assert classes[0, cell].tolist() == pytest.approx([1 / (1 + np.exp(-2.0)), 0.5])


def test_dead_channels_follow_the_writing_program(tmp_path: Path) -> None:
    """sqrt(var + 1e-5) in AlexeyAB's revision 5, sqrt(var) + 1e-6 in the original: thousands apart at variance 0."""
    network = build_network(TINY_CFG)
    network.layers[0].norm.running_var[0] = 0.0
    _, weights = write_darknet(TINY_CFG, network, tmp_path / "net")
    scales = {}
    for revision in (5, 0):
        content = bytearray(weights.read_bytes())
        content[8:12] = struct.pack("<i", revision)
        weights.write_bytes(content)
        norm = read_weights(build_network(TINY_CFG), weights).layers[0].norm
        scales[revision] = norm.scale_and_shift()[0][0].item()
    assert scales[5] == pytest.approx(1e5**0.5)
    assert scales[0] == pytest.approx(1e6)


def test_written_files_read_back_identical(tmp_path: Path) -> None:
    network = build_network(TINY_CFG, seed=4)
    cfg, weights = write_darknet(TINY_CFG, network, tmp_path / "out", seen=77)
    assert cfg.read_text() == TINY_CFG
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out.cfg", "out.weights"]
    again = read_weights(Network(read_cfg(cfg)), weights)
    for (_, _, a), (_, _, b) in zip(stored_tensors(network), stored_tensors(again), strict=True):
        assert torch.equal(a, b)
    with pytest.raises(ValueError, match="not built from this cfg"):
        write_darknet(TINY_CFG.replace("filters=8", "filters=4"), network, tmp_path / "other")
    with pytest.raises(ValueError, match="folded"):
        write_darknet(TINY_CFG, network.eval().fold(), tmp_path / "folded")


@pytest.mark.parametrize(("cut", "more"), [(40, b""), (0, b"\0" * 8), (0, b"\0"), (None, b"")])
def test_wrong_number_of_weights(cut: int | None, more: bytes, tmp_path: Path) -> None:
    spec, weights = write_tiny(tmp_path), tmp_path / "tiny.weights"
    content = weights.read_bytes()
    total = (len(content) - 20) // 4
    if cut is None:
        weights.unlink()
        words = f"no such file .expected {total:,} floats"
    else:
        weights.write_bytes(content[: len(content) - cut] + more)
        words = f"expected {total:,} floats for .*tiny.cfg, found {total + (len(more) - cut) // 4:,}"
    with pytest.raises(InputError, match=f"tiny.weights: {words}"):
        load_detector(spec)


@pytest.mark.parametrize("poison", [float("nan"), float("inf")])
def test_weights_that_are_not_numbers(poison: float, tmp_path: Path) -> None:
    spec = write_tiny(tmp_path)
    weights = tmp_path / "tiny.weights"
    content = weights.read_bytes()
    weights.write_bytes(content[:-4] + struct.pack("<f", poison))
    with pytest.raises(InputError, match=r"tiny.weights: weights of layer 3 .\[convolutional\], cfg line 26"):
        load_detector(spec)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[net]", "[nut]", "does not begin with .net."),
        ("filters=12", "filters=13", r"cfg:33: \[region\] 2 anchors and 1 classes need 12 channels"),
        ("filters=12", "filters=twelve", r"cfg:26: .*filters=twelve is not an integer"),
        ("anchors=1,2, 2,4", "anchors=1,2, 2", r"cfg:33: .*num=2 needs 4 numbers in anchors=, found 3"),
        ("[maxpool]\n", "nonsense\n", r"cfg:14: expected \[section\] or key=value, found 'nonsense'"),
        ("filters=16\nsize=3\nstride=2\npad=1", "filters=16\nsize=33", r"cfg:18: .*the input 64x64 is too small to"),
        ("size=2\nstride=2", "size=2\npadding=0", r"cfg:14: .*padding=0 is not supported"),
        ("stride=1\npad=1", "stride=1\npadding=1", r"cfg:26: .*padding=1 is not supported"),
        ("width=64\n", "", r"cfg:1: \[net\] lacks width="),
        ("channels=3", "channels=1", r"cfg:1: .*only networks on RGB images"),
    ],
)
def test_bad_cfg_names_the_line(old: str, new: str, message: str) -> None:
    assert old in TINY_CFG
    with pytest.raises(InputError, match=message) as caught:
        Network(parse_cfg(TINY_CFG.replace(old, new, 1)))
    assert "\n" not in str(caught.value)


def test_input_size_that_does_not_fit_is_explained() -> None:
    cfg = read_cfg(GOLDEN / "yolov4-parts.cfg")
    with pytest.raises(InputError, match=r"yolov4-parts.cfg:\d+: \[route\] joins layers of different sizes"):
        Network(cfg, (66, 66))


def test_swapped_files_are_recognised(tmp_path: Path) -> None:
    big = tmp_path / "big.weights"
    big.write_bytes(b"\0" * (2 << 20))
    with pytest.raises(InputError, match=r"big\.weights: larger than any file"):
        load_detector(f"darknet:{big}:{tmp_path / 'x.cfg'}")


def seeded_inputs(network: Network, weights_out: Path, revision: int) -> Tensor:
    """Write a .weights file for a network and return the image [3, H, W] that goes with it.

    The .npz beside each cfg holds what Darknet itself computed from them on the CPU (yolov4-parts: AlexeyAB's, commit
    59596d78; yolov2-parts: the original, commit f6afaab), one array per detection layer, as the layer leaves it.
    """
    rng = np.random.default_rng(11)
    parts = []
    for _, name, tensor in stored_tensors(network):
        shape = tuple(tensor.shape)
        if name in ("scales", "rolling variances"):
            parts.append(rng.random(shape) + 0.5)
        elif len(shape) == 4:
            parts.append(rng.standard_normal(shape) * (2 / np.prod(shape[1:])) ** 0.5)
        else:
            parts.append(rng.standard_normal(shape) * 0.3)
    values = np.concatenate([part.ravel() for part in parts]).astype("<f4")
    weights_out.write_bytes(struct.pack("<iiiq", 0, 2, revision, 0) + values.tobytes())
    height, width = network.input_size
    return torch.from_numpy(rng.random((3, height, width), dtype=np.float32))
