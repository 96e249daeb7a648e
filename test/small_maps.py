"""A small map file for tests of what is made of map files."""

import core_worlds as cw
from persem_ros.core.refine.whole import refine
from persem_ros.outputs.export.source import MapSource
from persem_ros.outputs.map import store
from persem_ros.settings.config import Config, updated
from persem_ros.settings.legend import Legend

LEGEND = Legend.from_yaml("""
title: test
classes:
- {id: 1, name: road, color: [9, 9, 9], cost: 0, las: 11}
- {id: 2, name: "wall <&>", color: [200, 0, 0], cost: 100, las: 64}
- {id: 3, name: tree, color: [0, 90, 0]}
- {id: 4, name: grass, color: [0, 200, 0], cost: 30}
""")
ORIGIN = (100.0, 200.0, 7.0)
FLOOR = {(i, j, 0): (1, 1.0) for i in range(-20, 20) for j in range(-3, 12)}
TALL = {(5, 5, k): (2, 1.0) for k in range(1, 9)}       # a wall of one column
CROWN = {(i, 0, 30): (3, 0.5) for i in range(-20, 0)}   # above the robot
UNDER = {(0, 0, 12): (4, 0.75)}                         # above a ground that nobody saw


def written(path, frames=3, legend=LEGEND, **settings):
    """Save a floor with a wall, a crown above and a hole in the floor; return its MapSource."""
    config = updated(Config(), {'map.origin': list(ORIGIN), **settings})
    memory = cw.core_of([])
    memory.origin = ORIGIN
    for t in range(frames):
        seen = {**FLOOR, **TALL, **CROWN, **UNDER}
        del seen[0, 0, 0]
        seen[3, 3, 0] = (4 if t == 1 else 1, 1.0)
        memory.add(cw.observations(10 ** 9 * t + 5, seen))
    refine(memory, config.refine)
    store.save(path, memory, config, legend)
    return MapSource(path), memory
