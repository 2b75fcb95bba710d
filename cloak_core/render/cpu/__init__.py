"""The stages of rendering as numba loops, for the CPU."""
