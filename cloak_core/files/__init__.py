"""The ground floor: reading and writing files that may be anyone's, locks, caches, and what a thing is.

Numpy and the standard library only, and no import from the rest of the project: the Blender extension ships this very
folder, beside `exchange`.
"""
