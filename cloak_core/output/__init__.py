"""What comes out: print sheets, textured bodies, a logo on another topology."""
