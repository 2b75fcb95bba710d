"""Bodies: meshes, people, motions, logos; posed before a camera they are a source of views."""
