"""What Cloak and Blender tell each other: bodies, scenes, face lists and colours, as objects and as files.

Numpy, the standard library and `files` only: the Blender extension ships this very folder. Everything read here may
come from strangers; whatever is wrong is said in one line that names the file (`InputError`).

Conventions: metres, right-handed, y up, bodies facing +z; colours are display-referred sRGB in [0, 1].
"""
