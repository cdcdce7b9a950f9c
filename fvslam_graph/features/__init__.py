"""Corners in an image, and which corner is which in the next image."""
