"""What all figures share: one look, no global state, SVG and PNG, the same bytes every time."""

from __future__ import annotations

import io
from typing import Any, Literal, TYPE_CHECKING

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from persem_ros.outputs.files import write_bytes

if TYPE_CHECKING:
    from contextlib import AbstractContextManager
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.typing import RcKeyType

# Okabe and Ito's colours; methods of one family share a colour and differ in their marker.
INK, SOFT = '#1b1f24', '#8a9099'
STYLES = {
    'raw2d': ('#d55e00', 'X'), 'ema2d': ('#e69f00', 'P'),
    'majority': ('#0072b2', 'o'), 'unweighted': ('#0072b2', 's'), 'recency': ('#56b4e9', 'v'),
    'consensus': ('#56b4e9', '^'), 'probabilistic': ('#0072b2', 'D'),
    'trust': ('#cc79a7', 'v'), 'context': ('#cc79a7', 's'), 'history': ('#cc79a7', 'D'),
    'context_history': ('#cc79a7', 'o'), 'persem': ('#009e73', '*'),
    'geometry': ('#000000', '*')}
LOOK: dict[RcKeyType, object] = {
    'font.family': ['DejaVu Sans'], 'font.size': 9, 'axes.spines.top': False,
    'axes.spines.right': False, 'axes.titlesize': 10, 'axes.titleweight': 'bold',
    'axes.titlelocation': 'left', 'axes.edgecolor': SOFT, 'axes.labelcolor': INK,
    'xtick.color': INK, 'ytick.color': INK, 'grid.color': '#e4e4df', 'grid.linewidth': 0.8,
    'axes.grid': True, 'axes.axisbelow': True, 'legend.frameon': False,
    'text.parse_math': False,       # names of classes and recordings are not formulas
    'svg.hashsalt': 'persem', 'svg.fonttype': 'path'}
WORDS = {'pixel_accuracy': 'pixel accuracy, %', 'miou': 'mean IoU, %', 'flicker': 'flicker, %'}


def look() -> AbstractContextManager[None]:
    """Return the context in which all figures are drawn."""
    return matplotlib.rc_context(LOOK)


def new_figure(width: float, height: float) -> Figure:
    """Return a Figure of *width* x *height* inches."""
    figure = Figure((width, height), layout='constrained')
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: Path) -> dict[str, bytes]:
    """Write <path>.svg and <path>.png; return the bytes of both."""
    figure.draw_without_rendering()
    figure.set_layout_engine('none')      # laid out once for both, not anew for each
    images = {}
    kinds: dict[str, dict[str, Any]] = {'svg': {'metadata': {'Date': None}}, 'png': {'dpi': 150}}
    for kind, options in kinds.items():
        out = io.BytesIO()
        figure.savefig(out, format=kind, facecolor='white', **options)
        images[kind] = out.getvalue()
        write_bytes(path.with_name(f'{path.name}.{kind}'), images[kind])
    return images


def lighter(axes: Axes, which: Literal['both', 'x', 'y'] = 'both') -> None:
    """Turn the grid lines of an axis off."""
    axes.grid(False, axis=which)
