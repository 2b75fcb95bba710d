"""Backgrounds without people."""
