"""Mesh files, and bodies from them."""
