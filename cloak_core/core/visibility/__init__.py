"""From geometry to fragments: what is visible of a body, and how it is lit."""
