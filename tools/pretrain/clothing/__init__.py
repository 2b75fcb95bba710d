"""How the embedded clothed people were made: gaits, garments cut from the sample mesh, Blender's cloth solver."""
