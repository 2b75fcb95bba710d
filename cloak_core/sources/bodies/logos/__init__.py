"""Which faces may change colour, and in which colours."""
