"""Detectors hardened against cloaks: adversarial fine-tuning, without labels."""
