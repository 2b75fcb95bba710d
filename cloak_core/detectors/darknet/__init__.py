"""Darknet's .cfg and .weights: the YOLO families from v2 to v4, read and written."""
