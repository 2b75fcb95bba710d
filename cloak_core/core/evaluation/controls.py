"""Names of what is judged: the pattern, and what it is compared with (`patterns/controls.py`)."""

LOGO = "logo"
"""The pattern that is judged."""
CLOTHING = "clothing"
STANDARD = (CLOTHING, "grey", "random")
"""The controls of every evaluation."""
RESAMPLED = "resampled"
NATURAL = ("stripes", "checks")
"""Patterns that clothes really have; asked for by the experiments."""
NAMES = (*STANDARD, RESAMPLED, *NATURAL)
