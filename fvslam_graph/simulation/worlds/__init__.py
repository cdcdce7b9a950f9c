"""Synthetic worlds, rendered as images with exact truth."""
