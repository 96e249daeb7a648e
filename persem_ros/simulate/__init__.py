"""A simulated flight: world, path, camera and a segmenter that makes mistakes."""
