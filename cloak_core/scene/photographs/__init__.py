"""Real people in real photographs: masks, landmarks, a body posed to each, and the photograph's shading."""
