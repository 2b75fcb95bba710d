"""Measure what detectors report of images, and count it."""
