"""How the sample bodies, the built-in detector and the patch segmenter were made."""
