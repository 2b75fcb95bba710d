"""Films: the cloaked body in motion beside its own clothing, and what detectors report in every frame."""
