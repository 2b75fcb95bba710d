"""Cloaks against detectors that training never saw: each judged detector's surrogates are all the others."""
