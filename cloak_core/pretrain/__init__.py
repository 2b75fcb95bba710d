"""How the sample bodies and the built-in detector were made."""
