"""The noun world: the town, the forest and the traffic, as triangles that rays can hit."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector

from persem_ros.simulate import shapes
from persem_ros.simulate import terrain as land
from persem_ros.simulate.materials import CLASS, GROUND, INDEX

ROOFS = np.array([(1, 1, 1), (.82, .80, .78), (.98, 1.3, 1.6), (.62, .85, 1.1), (1.1, 1.05, .95)])
WALLS = np.array([(1, 1, 1), (1.1, 1.08, 1.02), (.95, .82, .66), (.86, .88, .92), (1.05, .95, .8)])
PAINTS = np.array([(.9, .9, .9), (.12, .12, .13), (.45, .47, .5), (.6, .08, .07), (.1, .18, .45),
                   (.75, .75, .72), (.1, .3, .2), (.9, .75, .2)])


@dataclass(frozen=True, eq=False)
class Scene:
    """
    Triangles, what they are made of, and a ray caster (Embree, through trimesh).

    Attributes
    ----------
    origins, normals : ndarray, shape (n, 3), float64
        A corner and the unit normal of every triangle, metres.
    material : ndarray, shape (n,), uint8
        materials.GROUND for the terrain.
    tint : ndarray, shape (n, 3), float32
    base : ndarray, shape (n,), float32
        z of the foot of walls, metres.
    caster : trimesh.ray.ray_pyembree.RayMeshIntersector

    """

    origins: np.ndarray
    normals: np.ndarray
    material: np.ndarray
    tint: np.ndarray
    base: np.ndarray
    caster: object

    def first(self, origin, directions):
        """Return the triangle, -1 for none, that each ray from *origin* hits, shape (n,)."""
        return self.caster.intersects_first(np.broadcast_to(origin, directions.shape), directions)


def make_scene(solid):
    """Return the Scene of a shapes.Solid."""
    vertices, faces, material, tint, base = solid.arrays()
    mesh = trimesh.Trimesh(vertices, faces, process=False, validate=False)
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return Scene(corners[:, 0].copy(), normals, material, np.ascontiguousarray(tint), base,
                 RayMeshIntersector(mesh))


@dataclass(frozen=True)
class Mover:
    """A vehicle that drives along a straight street to and fro."""

    x0: float
    y0: float
    x1: float
    y1: float
    speed: float
    start: float
    tint: tuple
    truck: bool

    def at(self, time):
        """Return (x, y, yaw) at *time* in seconds; it drives on the right."""
        length = np.hypot(self.x1 - self.x0, self.y1 - self.y0)
        way = (self.start * 2 * length + self.speed * time) % (2 * length)
        back = way > length
        share = (2 * length - way if back else way) / length
        yaw = np.arctan2(self.y1 - self.y0, self.x1 - self.x0) + np.pi * back
        return (self.x0 + share * (self.x1 - self.x0) + 1.55 * np.sin(yaw),
                self.y0 + share * (self.y1 - self.y0) - 1.55 * np.cos(yaw), yaw)


@dataclass(frozen=True, eq=False)
class World:
    """Everything that is flown over: terrain, what stands still, what moves."""

    terrain: object
    scene: Scene
    movers: tuple

    def traffic(self, time):
        """Return the Scene of the moving vehicles at *time* in seconds."""
        solid = shapes.Solid()
        for mover in self.movers:
            x, y, yaw = mover.at(time)
            if mover.y0 == mover.y1 == 0:       # the main road is not straight
                y += float(land.main_road(x))
            z = self.deck(x, y)
            shapes.vehicle(solid, (x, y, z), yaw, mover.tint, mover.truck)
        return make_scene(solid)

    def deck(self, x, y):
        """Return z of the road at x, y: the ground's, or the bridge's."""
        z = float(self.terrain.height(np.array([x]), np.array([y]))[0])
        return max(z, _BRIDGE_TOP) if abs(x - land.river(y)) < 17 and abs(y) < 12 else z

    @cached_property
    def class_of_face(self):
        """Class ids of the faces of the scene, uint8; 0 where the ground map tells."""
        return np.append(CLASS, 0).astype(np.uint8)[self.scene.material]


_BRIDGE_TOP = .25


def make_world(seed):
    """Return the World of a seed: the same seed, the same world."""
    rng = np.random.default_rng([seed, 1])
    terrain = land.make_terrain(rng)
    solid = shapes.Solid()
    solid.add(*terrain.mesh(), GROUND)
    taken = _houses(solid, rng, terrain)
    _bridge(solid)
    _parked(solid, rng, terrain)
    _plants(solid, rng, terrain, taken)
    return World(terrain, make_scene(solid), _movers(rng))


def _on(terrain, points):
    """Return *points*, shape (n, 2), with the terrain's z as (n, 3)."""
    points = np.asarray(points, float).reshape(-1, 2)
    return np.column_stack([points, terrain.height(points[:, 0], points[:, 1])])


def _houses(solid, rng, terrain):
    """Build both sides of the streets; return what is taken: (n, 3) of x, y, radius."""
    taken = [np.array([[131.0, 29.0, 26.0]])]           # the car park
    blocks_x = (land.TOWN - 4, *land.STREETS_X, land.HALF_X)
    blocks_y = (-land.HALF_Y, *land.STREETS_Y[:3], 0.0, *land.STREETS_Y[3:], land.HALF_Y)
    for left, right in zip(blocks_x[:-1], blocks_x[1:]):
        for low, high in zip(blocks_y[:-1], blocks_y[1:]):
            if right - left > 20 and high - low > 20:
                _block(solid, rng, terrain, taken, left + 5.5, right - 5.5, low + 6, high - 6)
    hut = _on(terrain, [(-106.0, 22.0), (-60.0, -78.0), (-92.0, 60.0)])
    for at in hut:
        shapes.house(solid, at, rng.uniform(0, 3), (9, 6, 3), 'gable', WALLS[2] * .7, ROOFS[1])
    taken.append(np.column_stack([hut[:, :2], np.full(len(hut), 9.0)]))
    return np.concatenate(taken)


def _block(solid, rng, terrain, taken, left, right, low, high):
    """Two rows of lots, back to back, between four streets."""
    middle, x = (low + high) / 2, left
    big = rng.random() < .22
    while x + 12 < right:
        width = min(rng.uniform(26, 32) if big else rng.uniform(14, 19), right - x)
        for side in (-1, 1):
            depth = (high - low) / 2
            centre = np.array([x + width / 2, middle + side * (depth / 2 + 1)])
            if any(np.hypot(*(centre - t[:2])) < t[2] for part in taken for t in part):
                continue
            _lot(solid, rng, terrain, taken, centre, width, depth, side, big)
        x += width


def _lot(solid, rng, terrain, taken, centre, width, depth, side, big):
    """One house with its garden's fence or hedge and a paved way to the street."""
    flat = big or rng.random() < .12
    size = np.array([width - rng.uniform(4.5, 7), depth * rng.uniform(.40, .52),
                     rng.uniform(7, 12) if big else rng.uniform(3.2, 6.4)])
    size[:2] = np.maximum(size[:2], 6)
    roof = 'flat' if flat else ('gable', 'gable', 'hip')[rng.integers(3)]
    at = _on(terrain, centre + (rng.uniform(-1, 1), side * rng.uniform(0, 2)))[0]
    tint, roof_tint = WALLS[rng.integers(len(WALLS))], ROOFS[rng.integers(len(ROOFS))]
    if not flat and size[1] > size[0]:
        shapes.house(solid, at, np.pi / 2, (size[1], size[0], size[2]), roof, tint, roof_tint)
    else:
        shapes.house(solid, at, 0.0, size, roof, tint, roof_tint if not flat else WALLS[0])
    taken.append(np.array([[at[0], at[1], max(size[:2]) * .62]]))
    way = np.zeros((2, 2), int)
    way[:, 0] = ((at[0] + size[0] / 2 - 2.6 + np.array([0, 2.4]) + land.HALF_X) / land.CELL)
    way[:, 1] = np.sort((np.array([at[1], centre[1] + side * (depth / 2 + 2)]) + land.HALF_Y)
                        / land.CELL)
    patch = terrain.ground[way[0, 1]:way[1, 1], way[0, 0]:way[1, 0]]
    patch[patch == INDEX['grass']] = INDEX['paving']
    back, front = centre[1] - side * (depth / 2 + .6), centre[1] + side * (depth / 2 - 2.5)
    corner = [(centre[0] - width / 2, front), (centre[0] - width / 2, back),
              (centre[0] + width / 2, back)]
    kind = rng.random()
    line = _on(terrain, np.concatenate([np.linspace(a, b, 4) for a, b in
                                        zip(corner[:-1], corner[1:])]))
    if kind < .55:
        shapes.strip(solid, line, 1.3, .12, 'planks', np.full(3, rng.uniform(.7, 1.3)))
    elif kind < .85:
        shapes.strip(solid, line, 1.5, .9, 'shrub', np.full(3, rng.uniform(.8, 1.1)))


def _bridge(solid):
    """A deck with two parapets over the river, along the main road."""
    middle = float(land.river(0.0))
    y = float(land.main_road(middle))
    shapes.box(solid, (middle, y, _BRIDGE_TOP - .8), 0.0, (32, 8.6, .8), 'concrete', top='asphalt')
    for side in (-1, 1):
        shapes.box(solid, (middle, y + side * 4.1, _BRIDGE_TOP), 0.0, (32, .35, 1.0), 'planks',
                   (1.1, 1.5, 2.2))


def _parked(solid, rng, terrain):
    """Cars that stand in the car park and along the streets."""
    spots = [(111.5 + 3 * i, row, np.pi / 2) for i in range(13) for row in (18.0, 34.0)
             if rng.random() < .6]
    for street in land.STREETS_Y:
        spots += [(x, street + side * 4.0, 0.0) for x in np.arange(land.TOWN + 9, 240, 11)
                  for side in (-1, 1)
                  if rng.random() < .28 and np.abs(np.array(land.STREETS_X) - x).min() > 9]
    for x, y, yaw in spots:
        at = _on(terrain, (x, y))[0]
        shapes.vehicle(solid, at, yaw + rng.uniform(-.04, .04), PAINTS[rng.integers(len(PAINTS))])


def _plants(solid, rng, terrain, taken):
    """The forest, trees along river and in gardens, bushes."""
    x, y = (np.arange(-half + 3, half - 3, 5.2) for half in (land.HALF_X, land.HALF_Y))
    spot = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    spot += rng.uniform(-2.2, 2.2, spot.shape)
    luck = rng.random(len(spot))
    ground = terrain.material(spot[:, 0], spot[:, 1])
    clump = terrain.edges(spot.astype(np.float32) / 3)
    density = np.select([ground == INDEX[name] for name in ('forest floor', 'meadow', 'grass')],
                        [.93 - .5 * (clump > 1.0), .05 + .10 * (clump > .9), .26], 0.0)
    bank = np.abs(spot[:, 0] - land.river(spot[:, 1]))
    density[(bank > 12) & (bank < 17) & (ground != INDEX['forest floor'])] = .38
    density[(np.abs(spot[:, 1]) < 8) & (spot[:, 0] > -40)] = 0
    keep = luck < density
    for ring in np.array_split(taken, max(1, len(taken) // 16)):
        near = np.linalg.norm(spot[:, None] - ring[None, :, :2], axis=-1) < ring[None, :, 2]
        keep &= ~near.any(axis=1)
    small = terrain.material(spot[:, 0] + 1.6, spot[:, 1]) != ground
    _grow(solid, rng, terrain, spot[keep], ground[keep], small[keep] | (rng.random(keep.sum()) < .1))


def _grow(solid, rng, terrain, spot, ground, small):
    """Add a plant at each of *spot*, shape (n, 2): conifers and broadleaves, *small*: bushes."""
    n = len(spot)
    wood = ground == INDEX['forest floor']
    conifer = wood & (terrain.edges(spot.astype(np.float32) / 5 + 40) > -.1) & ~small
    broad = ~conifer & ~small
    at = _on(terrain, spot)
    size = rng.uniform(.75, 1.25, n)
    tint = (1 + .16 * rng.standard_normal((n, 1)) + rng.standard_normal((n, 3)) * (.16, .07, .05))
    tint = np.clip(tint, .45, 1.7)
    for mine, kind, radius, height in (
            (conifer, 'needles', 2.1, 12.0), (broad & wood, 'leaves', 3.1, 10.5),
            (broad & ~wood, 'leaves', 2.4, 6.5), (small, 'shrub', 1.3, 1.7)):
        shapes.crowns(solid, rng, at[mine], radius * size[mine],
                      height * size[mine] * rng.uniform(.85, 1.15, mine.sum()), kind, tint[mine])


def _movers(rng):
    """The traffic: along the streets of the town and over the bridge."""
    lanes = [(-250.0, 0.0, 250.0, 0.0)] * 9
    lanes += [(x, -200.0, x, 200.0) for x in land.STREETS_X[:3] for _ in range(5)]
    lanes += [(land.TOWN + 6, y, 250.0, y) for y in land.STREETS_Y[1:5] for _ in range(2)]
    return tuple(Mover(*lane, rng.uniform(6, 12), rng.random(),
                       tuple(PAINTS[rng.integers(len(PAINTS))]), bool(rng.random() < .18))
                 for lane in lanes)
