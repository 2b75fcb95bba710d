"""Measures what detectors report of images. Here, the names of what is judged and compared (`patterns/controls.py`)."""

LOGO = "logo"
"""The pattern that is judged."""
CLOTHING = "clothing"
STANDARD = (CLOTHING, "grey", "random")
"""The controls of every evaluation."""
RESAMPLED = "resampled"
NATURAL = ("stripes", "checks")
"""Patterns that clothes really have; asked for by the experiments."""
NAMES = (*STANDARD, RESAMPLED, *NATURAL)
