"""Settings of the mapping itself: memory, refinement, rendering."""

from __future__ import annotations

from dataclasses import dataclass

from persem_ros.settings.setting import setting

METHODS = ('majority', 'unweighted', 'recency', 'consensus', 'probabilistic',
           'trust', 'context', 'history', 'context_history', 'persem', 'geometry')
IMAGE_METHODS = ('raw2d', 'ema2d')


@dataclass(frozen=True)
class Memory:
    """Which pixels are remembered, and how finely."""

    voxel_size: float = setting(0.5, 'edge of a voxel', 'm', 1e-3, 1e3, live=False)
    min_depth: float = setting(0.1, 'nearer measurements are ignored', 'm', 0.0, 1e5)
    max_depth: float = setting(200.0, 'farther measurements are ignored', 'm', 0.0, 1e5)
    stride: int = setting(
        1, 'integrate every n-th pixel of every n-th row; 0: auto, as many as leave a voxel three '
        'pixels wide at the median depth', 'pixels', 0, 64)
    min_pixels: int = setting(1, 'pixels that make an observation of a voxel', 'pixels', 1, 10000)
    ignore_labels: tuple[int, ...] = setting((255, 65535), 'ids that are not observations')
    dynamic_labels: tuple[int, ...] = setting(
        (-1,), 'ids of things that move: never integrated, passed through unchanged; -1: none')
    max_history: int = setting(
        0, 'newest observations that a refinement reads per voxel; 0: all', 'observations', 0,
        1 << 20, live=False)
    max_voxels: int = setting(
        0, 'voxels kept in memory: where there are more, the farthest blocks go (node, and '
        'replays into attached maps); 0: all',
        'voxels', 0, 1 << 32)
    keep_radius: float = setting(
        0.0, 'blocks of voxels farther from the camera are forgotten (node); 0: none', 'm', 0.0,
        1e6)
    clear_after: int = setting(
        0, 'looks through a voxel, in as many seconds and since it was last observed, after which '
        'what stood there has moved away (and a tenth of its observations, where those are more); '
        '0: never', 'looks', 0, 1 << 20)
    clear_margin: float = setting(
        1.5, 'how far behind a voxel all that is measured must lie to look through it', 'voxels',
        0.0, 1000.0)
    clear_slope: float = setting(
        0.02, 'and how much more for each metre of distance', 'm/m', 0.0, 10.0)
    clear_range: float = setting(
        30.0, 'voxels farther along the optical axis are not looked through', 'm', 0.0, 1e5)


@dataclass(frozen=True)
class Geometry:
    """The method geometry; lengths are in voxels, so that one set serves all resolutions."""

    directions: int = setting(
        8, 'bins of viewing directions along half an axis: looks from one bin are one vote; '
        '0: every look is one', '', 0, 32)
    window: int = setting(20, 'columns around one whose lowest voxels make its ground', 'voxels',
                          0, 1000)
    cell: int = setting(32, 'edge of the areas that have habits of their own', 'voxels', 2, 4096)
    weight: float = setting(0.5, 'weight of what shapes and areas say; 0: none', '', 0.0, 100.0)
    smoothing: float = setting(6.0, 'weight of what the neighbours say (lambda); 0: none', '',
                               0.0, 100.0)
    prior: float = setting(60.0, 'voxels that a group of places must outweigh', 'voxels', 1e-3,
                           1e9)
    shrink: float = setting(0.1, "share of all looks that the classes' confusions must outweigh",
                            '', 1e-6, 1e3)
    rounds: int = setting(3, 'rounds in which the parameters are fitted', '', 1, 100)
    groups: str = setting('both', 'which groups of places have habits: shapes anywhere, kinds in '
                          'areas, or both (an ablation)', choices=('both', 'shapes', 'cells'))
    heights: str = setting(
        '', "heights above the ground that classes keep to, as '3 -2 2; 5 4 inf': id, lowest, "
        "highest; empty: those of the legend (its key height, in metres); 'none': none", 'voxels')


@dataclass(frozen=True)
class Refine:
    """How the memory makes up its mind."""

    method: str = setting('persem', 'labelling method', choices=METHODS)
    min_observations: int = setting(
        3, 'observations that make a voxel recurrent; fewer are not refined', 'observations', 1,
        1 << 20)
    neighbours: int = setting(26, 'neighbourhood of a voxel: 6, 18 or 26')
    eta: float = setting(0.3, "share of the neighbours' history in the anchor (eta)", '', 0.0, 1.0)
    lambda_volatility: float = setting(
        1.0, 'how strongly a volatile class is distrusted (lambda_v)', '', 0.0, 100.0)
    lambda_disagreement: float = setting(
        0.5, 'how strongly a surprise is distrusted (lambda_s)', '', 0.0, 100.0)
    lambda_gap: float = setting(
        0.01, 'how strongly a gap in time is distrusted (lambda_t)', '1/frame', 0.0, 100.0)
    gamma: float = setting(0.95, 'decay of replayed evidence (gamma)', '', 0.0, 1.0)
    tau_replay: float = setting(0.1, 'margin of a trust proposal (tau_replay)', '', 0.0, 1e6)
    tau_context: float = setting(0.1, 'margin of its verification (tau_context)', '', 0.0, 1.0)
    lambda_recency: float = setting(
        0.05, 'decay of the methods recency and consensus (lambda_r)', '1/frame', 0.0, 100.0)
    beta: float = setting(0.5, 'bonus of the method consensus (beta)', '', 0.0, 100.0)
    period: float = setting(1.0, 'time between refinements', 's', 0.01, 3600.0)
    volatility_every: int = setting(
        10, 'refinements, at least, before the class volatility is taken anew; all voxels have '
        'seen the last one by then (node, --causal)', '', 1, 1 << 20)
    sweep: int = setting(
        100_000, 'voxels that a refinement visits, beside those that changed, until all have '
        'seen the class volatility in force (node, --causal)', 'voxels', 1, 1 << 30)
    up: str = setting('z', 'axis of the map that points up (geometry)',
                      choices=('x', 'y', 'z', '-x', '-y', '-z'))
    geometry: Geometry = Geometry()


@dataclass(frozen=True)
class Render:
    """How refined label images are filled."""

    fill: str = setting(
        'input', "a pixel that the map does not know: the frame's own label or the ignored id",
        choices=('input', 'unknown'))


@dataclass(frozen=True)
class Ema:
    """Image-space smoothing, a baseline."""

    alpha: float = setting(0.7, 'share of the past in the smoothed image (alpha)', '', 0.0, 1.0)
