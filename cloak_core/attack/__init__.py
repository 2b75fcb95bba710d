"""Losses, sampling and the training of face colours."""
