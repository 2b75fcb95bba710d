"""Families of person detectors, their verification, and defences before them."""
