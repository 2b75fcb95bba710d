"""Trained colours that ship with the project: `zoo:NAME` wherever a run folder is taken."""
