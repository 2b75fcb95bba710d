"""Photographs and videos of people with and without a cloak, judged by detectors."""
