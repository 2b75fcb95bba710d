"""Real people in photographs, dressed in trained colours or in anybody's picture, and judged."""
