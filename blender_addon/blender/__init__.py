# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's data as numpy sees it: meshes, colours, logos, paths."""
