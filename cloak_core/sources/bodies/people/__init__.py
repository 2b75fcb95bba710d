"""Bodies of people: the embedded ones, SMPL, Anny."""
