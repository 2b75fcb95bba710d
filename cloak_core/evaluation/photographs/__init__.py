"""Photographs and videos of people with and without a cloak, judged by detectors.

`listing` (which pictures, who, where), `looking` (what detectors say), `counting` (rates with intervals), `page` (the
report), `planning` (how many pictures are needed).
"""
