"""The noun material: what a surface is made of, its class and its colour."""

import numpy as np

# Class ids of config/labels/town.yaml.
GRASS, FIELD, ROAD, PAVEMENT, BUILDING, TREE, SHRUB, WATER, FENCE, VEHICLE = range(1, 11)
VOID = 255

# How the renderer draws a material (render.py).
PLAIN, ROWS, RIPPLES, WINDOWS, TILES, FOLIAGE, GLOSS, SLABS = range(8)

# name: (class id, red, green, blue of the albedo, strength of its texture, its size in metres,
# pattern)
_TABLE = {
    'grass': (GRASS, .29, .355, .165, .45, 2.2, PLAIN),
    'meadow': (GRASS, .385, .405, .19, .40, 3.5, PLAIN),
    'forest floor': (GRASS, .20, .21, .11, .60, 1.2, PLAIN),
    'soil': (FIELD, .43, .31, .20, .25, 1.5, ROWS),
    'crop': (FIELD, .62, .53, .25, .25, 2.0, ROWS),
    'asphalt': (ROAD, .235, .24, .25, .22, 1.8, PLAIN),
    'marking': (ROAD, .80, .80, .77, .20, .8, PLAIN),
    'paving': (PAVEMENT, .57, .54, .50, .18, .9, SLABS),
    'gravel': (PAVEMENT, .59, .51, .39, .35, .6, PLAIN),
    'water': (WATER, .07, .17, .20, .30, 6.0, RIPPLES),
    'wall': (BUILDING, .78, .73, .65, .12, 1.5, WINDOWS),
    'tiles': (BUILDING, .50, .275, .205, .25, 1.2, TILES),
    'flat roof': (BUILDING, .50, .50, .49, .20, 2.5, PLAIN),
    'leaves': (TREE, .17, .31, .09, .75, .7, FOLIAGE),
    'needles': (TREE, .10, .22, .11, .65, .45, FOLIAGE),
    'trunk': (TREE, .30, .22, .15, .30, .3, PLAIN),
    'shrub': (SHRUB, .30, .38, .13, .70, .5, FOLIAGE),
    'planks': (FENCE, .52, .38, .25, .25, .5, PLAIN),
    'concrete': (ROAD, .62, .61, .58, .20, 1.5, PLAIN),
    'paint': (VEHICLE, .85, .85, .85, .05, 1.0, GLOSS),
    'glass': (VEHICLE, .08, .10, .13, .05, 1.0, GLOSS),
}

NAMES = tuple(_TABLE)
INDEX = {name: i for i, name in enumerate(NAMES)}
GROUND = len(NAMES)     # of a terrain face: the ground map tells the material

# Indexed by material: class id uint8; albedo, texture strength, texture size float32; pattern.
CLASS = np.array([row[0] for row in _TABLE.values()], np.uint8)
ALBEDO = np.array([row[1:4] for row in _TABLE.values()], np.float32)
STRENGTH = np.array([row[4] for row in _TABLE.values()], np.float32)
SIZE = np.array([row[5] for row in _TABLE.values()], np.float32)
PATTERN = np.array([row[6] for row in _TABLE.values()], np.uint8)
