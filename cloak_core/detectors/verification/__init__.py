"""The verification kit: does a wrapper keep what a detector promises? `cloak detectors verify SPEC`, or from Python

    report = verify(load_detector(SPEC), images)

Read in this order: `kit` (the report), `checks` (what is asked), `comparing` (when two answers are the same, and
gradients against finite differences).
"""

from cloak_core.detectors.verification.kit import verify

__all__ = ["verify"]
