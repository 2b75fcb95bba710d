"""What a detector is to everything else: one call, its outcomes, and who loads it is not asked."""

THRESHOLD = 0.6
"""A person is detected when a box's score exceeds this (the paper's value)."""
IOU = 0.5
"""A box is on a body when it overlaps the body's true box at least this much."""
