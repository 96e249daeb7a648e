"""
One frame: images to points, points to observations, voxels back to images.

In: arrays and a pose. Out: Observations, images of voxel numbers and of labels.
Enters memory/ to find voxels; refine/ and the pipeline enter here.

"""
