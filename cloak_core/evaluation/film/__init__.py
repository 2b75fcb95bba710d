"""Films: the cloaked body in motion beside its own clothing, and what a detector makes of every frame.

`camera_path` (where the camera is), `shooting` (frames and what detectors say), `tracking` and `counting` (numbers),
`drawing` (pictures), `making` (all of it, into a file).
"""
