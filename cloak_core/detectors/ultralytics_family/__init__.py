"""ultralytics' detectors and original YOLOv5 pickles: read safely, rebuilt, and run with gradients.

Read in this order: `checkpoint` (what a .pt says of itself), `architecture` (descriptions of networks, and the package
that builds them, kept quiet and offline), `heads` (from features to boxes), `detector`.
The package is AGPL-3.0: it is an extra, and imported only when such a detector is asked for.
"""
