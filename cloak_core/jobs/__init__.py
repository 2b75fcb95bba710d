"""A list of work and who does it: this process, one after the other, or a Ray cluster."""
