"""Where the map lies on the Earth: map.crs and map.georeference."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.errors import PersemError
from persem_ros.outputs.export.libraries import needed

if TYPE_CHECKING:
    from persem_ros.outputs.export.source import MapSource


@dataclass(frozen=True)
class Place:
    """
    The map frame in a coordinate reference system.

    Attributes
    ----------
    crs : str
        As map.crs; '' where the map is not tied to the Earth.
    east, north, up : float
        Of the map frame's origin, metres.
    yaw : float
        From east to the map frame's x axis, counter-clockwise, degrees.

    """

    crs: str = ''
    east: float = 0.0
    north: float = 0.0
    up: float = 0.0
    yaw: float = 0.0

    def placed(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points (n, 3) of the map frame as east, north, up; metres."""
        c, s = self.cos_sin
        x, y, z = points.T
        return np.stack([self.east + c * x - s * y, self.north + s * x + c * y, self.up + z],
                        axis=1)

    @property
    def cos_sin(self) -> tuple[float, float]:
        """Return cosine and sine of the yaw, exact for quarter turns."""
        if self.yaw % 90 == 0:
            return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[int(self.yaw // 90) % 4]
        return math.cos(math.radians(self.yaw)), math.sin(math.radians(self.yaw))


def place_of(source: MapSource) -> Place:
    """Return the Place of a map."""
    return Place(source.config.map.crs, *source.config.map.georeference)


def projected(text: str, what: str = 'map.crs') -> Any:
    """
    Return the pyproj CRS that *text* names; it must be projected, in metres.

    Raises
    ------
    PersemError
        For a system that does not exist, has degrees for axes or another unit.

    """
    pyproj = needed('pyproj', f'{what} {text!r}')
    try:
        crs = pyproj.CRS.from_user_input(text)
    except pyproj.exceptions.CRSError:
        raise PersemError(f'{what}: there is no coordinate reference system {text[:80]!r}; '
                          'expected an EPSG code such as EPSG:25832 (ETRS89, UTM zone 32N)'
                          ) from None
    if not crs.is_projected or any(abs(axis.unit_conversion_factor - 1) > 1e-9
                                   for axis in crs.axis_info[:2]):
        raise PersemError(f'{what}: {text} ({crs.name}) is not measured in metres; expected a '
                          'projected system, for example EPSG:25832 (ETRS89, UTM zone 32N)')
    return crs
