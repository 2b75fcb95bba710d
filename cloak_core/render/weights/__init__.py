"""From what is seen to a view's matrix: light, texture coordinates, weights."""
