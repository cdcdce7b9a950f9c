"""Synthetic worlds and scenes of points, with what sees them."""
