"""torch.compile for a detector: fused kernels, for a compilation at the first images of each size."""

import torch

from cloak_core.detectors.protocol import Detections, Detector
from cloak_core.files.errors import InputError


def compile_detector(detector: Detector) -> Detector:
    """Compile the detector's `detect`. InputError: a black box, or no compiler is found.

    Results equal the uncompiled ones up to rounding; what torch cannot compile runs as before.
    """
    if not detector.differentiable:
        raise InputError(f"--compile: {detector.spec} does not run in torch")
    run = torch.compile(detector.detect)

    def detect(images: torch.Tensor) -> Detections:
        try:
            return run(images)
        except (torch._inductor.exc.InvalidCxxCompiler, torch._dynamo.exc.BackendCompilerFailed) as error:
            reason = str(error).strip().splitlines()[0][:160]
            raise InputError(
                f"--compile: torch cannot compile here ({reason}); install a C++ compiler, or drop it"
            ) from error

    detector.detect, detector.compiled = detect, True
    return detector
