"""A Darknet network as a frozen Cloak detector."""

from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.detector.protocol import Detections, Detector
from cloak_core.detectors.classes import names_beside, person_index
from cloak_core.detectors.darknet.cfg import read_cfg
from cloak_core.detectors.darknet.network import Network
from cloak_core.detectors.darknet.weights import check_size, read_weights
from cloak_core.detectors.decoding import decode_heads
from cloak_core.detectors.pixels import fit
from cloak_core.detectors.specs import Request
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_record

BUILTIN_CFG = Path(__file__).parents[1] / "builtin.cfg"
BUILTIN_WEIGHTS = BUILTIN_CFG.with_suffix(".weights")
"""The detector that comes with Cloak: a small person detector of the YOLOv2 family, trained by tools/pretrain."""


class DarknetDetector(Detector):
    """Resizes images to the network's input, runs it, and gives boxes in the images' pixels.

    Scores are objectness times the person class's probability, as Darknet thresholds them.
    """

    operating_point = 0.25

    def __init__(
        self, network: Network, person: int, name: str, spec: str, letterbox: bool = False, channels_last: bool = True
    ) -> None:
        super().__init__(name, spec)
        self.person, self.letterbox = person, letterbox
        # Faster on every CPU and network measured: 1.05 (yolov2) to 1.4 (YOLO-LITE) times, forward and input gradient.
        self.memory_format = torch.channels_last if channels_last else torch.contiguous_format
        self.network = network.to(memory_format=self.memory_format)

    def detect(self, images: Float[Tensor, "B 3 H W"]) -> Detections:
        size = self.network.input_size
        inputs, placement = fit(images, size, self.letterbox)
        maps = self.network(inputs.contiguous(memory_format=self.memory_format))
        return decode_heads(self.network.heads, maps, size).of_person(self.person, placement)


def load_darknet(request: Request) -> DarknetDetector:
    """Load `darknet:CFG:WEIGHTS`, or the embedded detector (`builtin`, or `builtin:WEIGHTS` of the same network).

    It is frozen, batch norm folded (unless told not to), channels last. Class names come from a .names file beside the
    cfg, or are COCO's or VOC's by their number. InputError as in `read_cfg`, `Network`, `read_weights` and
    `person_index`.
    """
    is_builtin, files = request.family == "builtin", [Path(part).expanduser() for part in request.parts]
    cfg, weights = (BUILTIN_CFG, *files, BUILTIN_WEIGHTS)[:2] if is_builtin else files
    sections = read_cfg(cfg)
    # A cfg of a few lines can ask for any amount of memory: none is taken before the file of weights bears it out.
    with torch.device("meta"):
        check_size(Network(sections, request.input_size), weights)
    network = Network(sections, request.input_size)
    counts = {head.classes for head in network.heads}
    if len(counts) != 1:
        raise InputError(f"{cfg}: its heads have different numbers of classes {sorted(counts)}")
    count = counts.pop()
    names = ("person",) if is_builtin else names_beside(cfg, count)
    person = person_index(names, request.person, count, str(cfg))
    read_weights(network, weights)
    network.eval()
    network = network.fold() if request.fold else network
    detector = DarknetDetector(network, person, cfg.stem, request.spec, request.letterbox, channels_last=request.fold)
    detector.class_names = names
    if is_builtin:  # it was trained and judged for that
        detector.operating_point, detector.operating_point_assumed = 0.5, False
    detector.source = {
        "cfg": sha256_record([(section.kind, section.options) for section in sections]),
        "input_size": list(network.input_size),
        "letterbox": request.letterbox,
        "person": person,
    }
    return detector.freeze()
