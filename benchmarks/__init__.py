"""Measurements for developers: speed against error, growth, peers, and all of a CUDA device; see docs/accuracy.md."""
