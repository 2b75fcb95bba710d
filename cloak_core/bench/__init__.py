"""Times of views, steps and detectors on this machine, and the stability of visibility."""
