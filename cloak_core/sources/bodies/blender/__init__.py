"""Scenes that only Blender reads, through a Blender outside this process."""
