"""Data sets on disk become recordings."""
