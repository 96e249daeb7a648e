"""A map from above, as a picture: of each column of voxels the topmost."""

import cv2
import numpy as np
import persem_ros

CELLS = 600         # of a picture, along its longer side


def of(path):
    """Return a picture of a map file: of each column of voxels the topmost; and its corners."""
    found = persem_ros.open_map(path)
    columns, colors = found.columns(), found.legend.colors
    at = columns['voxel'].astype(np.int64)
    low, high = (np.quantile(at[:, :2], q, axis=0, method='nearest') for q in (0.001, 0.999))
    return at, colors(columns['label']), low, high


def drawn(maps, corners):
    """Return pictures of maps side by side, between the same corners, (H, W, 3) uint8."""
    low, high = corners
    scale = int(-(-(high - low + 1).max() // CELLS))
    width, height = ((high - low) // scale + 1).tolist()
    pictures = []
    for title, (at, rgb, *_) in maps.items():
        picture = np.full((height, width, 3), 255, np.uint8)
        inside = np.flatnonzero(((at[:, :2] >= low) & (at[:, :2] <= high)).all(axis=1))
        inside = inside[np.argsort(at[inside, 2], kind='stable')]       # the topmost comes last
        cell = (at[inside, :2] - low) // scale
        picture[height - 1 - cell[:, 1], cell[:, 0]] = rgb[inside][:, ::-1]
        strip = np.full((24, width, 3), 255, np.uint8)
        cv2.putText(strip, title, (4, 17), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1,
                    cv2.LINE_AA)
        pictures.append(np.concatenate([strip, picture]))
    gap = np.full((height + 24, 8, 3), 255, np.uint8)
    return np.concatenate([pictures[0], *(part for one in pictures[1:] for part in (gap, one))],
                          axis=1)
