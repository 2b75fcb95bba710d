"""Harden detectors: adversarial training against cloaks."""
