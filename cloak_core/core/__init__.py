"""The idea: an image is a sparse map of what is worn. Training and measuring it, and nothing optional."""
