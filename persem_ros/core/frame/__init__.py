"""
One frame: images to points, points to observations, voxels back to images.

In: arrays and a pose. Out: Observations, images of voxel numbers and of labels.
Enters memory/ to find voxels; entered by the pipeline and by whoever renders or counts.

"""
