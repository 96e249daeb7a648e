"""Tie a map to the Earth: fit its camera track to satellite fixes, enter the result."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
import math
from pathlib import Path
import sqlite3
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.errors import PersemError
from persem_ros.guard.database import check_declared, harden, Unsafe
from persem_ros.outputs.export.libraries import needed
from persem_ros.outputs.export.place import Place, projected
from persem_ros.outputs.map.loading import reading
from persem_ros.outputs.map.lock import WriterLock
from persem_ros.outputs.map.rows import about_rows, crc_of
from persem_ros.outputs.map.store import declared_as_ours, fold_log
from persem_ros.outputs.map.tables import ORDER, TABLES
from persem_ros.settings import config_file
from persem_ros.settings.config import updated

if TYPE_CHECKING:
    from persem_ros.outputs.export.source import MapSource

GAP = 2.0               # s between two frames between which the camera's track is interpolated
LEAST = 3               # fixes
HIGHEST = 1e6           # m: what is said to be higher is no altitude


@dataclass(frozen=True, eq=False)
class Fixes:
    """
    What a satellite receiver said.

    Attributes
    ----------
    stamp : ndarray, shape (n,), int64
        Nanoseconds.
    latitude, longitude : ndarray, shape (n,), float64
        Degrees, WGS 84.
    altitude : ndarray, shape (n,), float64
        Metres above the ellipsoid.

    """

    stamp: NDArray[np.int64]
    latitude: NDArray[np.float64]
    longitude: NDArray[np.float64]
    altitude: NDArray[np.float64]


@dataclass(frozen=True)
class Fit:
    """A Place, how many fixes it rests on, and how far they lie from it, metres."""

    place: Place
    fixes: int
    rms: float
    worst: float
    rms_up: float


def fitted(source: MapSource, fixes: Fixes, crs: str = '') -> Fit:
    """
    Return where the map frame lies so that the camera's track meets the fixes best.

    Least squares over turn about the vertical and shift, without scale (Umeyama 1991, in the
    plane); the distance of antenna and camera is not modelled.

    Parameters
    ----------
    source : MapSource
        Its frame table is the track.
    fixes : Fixes
        What the receiver said.
    crs : str
        The system to use; '': the zone of UTM that the fixes lie in (WGS 84).

    Raises
    ------
    PersemError
        Where fewer than three fixes lie within the flight, or all in one place.

    """
    keep = np.isfinite([fixes.latitude, fixes.longitude, fixes.altitude]).all(axis=0) \
        & (np.abs(fixes.latitude) <= 90) & (np.abs(fixes.longitude) <= 180) \
        & (np.abs(fixes.altitude) <= HIGHEST)
    fixes = Fixes(fixes.stamp[keep], fixes.latitude[keep], fixes.longitude[keep],
                  fixes.altitude[keep])
    track, within = _track(source, fixes.stamp)
    if within.sum() < LEAST:
        raise PersemError(
            f'{source.path}: {int(within.sum())} of {len(fixes.stamp)} fixes lie within the '
            f'flight ({_span(source.stamps)}; the fixes: {_span(fixes.stamp)}), at least {LEAST} '
            'are needed; are their stamps of the same clock?')
    lat, lon = fixes.latitude[within], fixes.longitude[within]
    zone = int((lon.mean() + 180) // 6) % 60 + 1
    crs = crs or f'EPSG:{(32600 if lat.mean() >= 0 else 32700) + zone}'
    pyproj = needed('pyproj', 'a georeference')
    east, north = pyproj.Transformer.from_crs('EPSG:4326', projected(crs, '--crs'),
                                              always_xy=True).transform(lon, lat)
    target = np.stack([east, north], axis=1)
    if not np.isfinite(target).all():
        raise PersemError(f'--crs {crs}: does not cover the fixes, which lie near latitude '
                          f'{lat.mean():.4f}, longitude {lon.mean():.4f}')
    flat = track[within, :2]
    a, b = flat - flat.mean(axis=0), target - target.mean(axis=0)
    yaw = math.atan2(float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()), float((a * b).sum()))
    c, s = math.cos(yaw), math.sin(yaw)
    turned = flat @ np.array([[c, s], [-s, c]])
    shift = (target - turned).mean(axis=0)
    rise = fixes.altitude[within] - track[within, 2]
    error = np.linalg.norm(target - turned - shift, axis=1)
    rms = float(np.sqrt((error ** 2).mean()))
    spread = float(np.sqrt((a ** 2).sum(axis=1).mean()))
    if spread < 1e-3 or spread < 2 * rms:
        raise PersemError(
            f'{source.path}: the turn of the map cannot be told: the flight spreads over '
            f'{spread:.2f} m and the fixes lie {rms:.2f} m off; fly farther, or give '
            '--shift EAST NORTH UP and --yaw DEGREES')
    place = Place(crs, float(shift[0]), float(shift[1]), float(rise.mean()), math.degrees(yaw))
    return Fit(place, int(within.sum()), rms, float(error.max()), float(rise.std()))


def enter(path: Path | str, place: Place) -> None:
    """
    Enter a Place into a map file, in one transaction.

    Raises
    ------
    PersemError
        For what is no whole map file of the present schema, or cannot be written.

    """
    path = Path(path)
    with reading(path) as (_, first):
        if first:
            raise PersemError(f'{path}: a map file of schema 1; bring it up first: persem replay '
                              'or the node with map.load and map.save do')
    try:
        with closing(WriterLock(path)):
            declared_as_ours(path)
            with closing(sqlite3.connect(path, isolation_level=None)) as db:
                harden(db)
                check_declared(db, TABLES)
                # A log can be read by anybody after a kill; a journal could not.
                db.execute('PRAGMA journal_mode = WAL').fetchall()
                _enter(db, path, place)
            fold_log(path, locked=True)
    except (sqlite3.Error, Unsafe) as error:
        raise PersemError(f'cannot write {path}: {error}') from error


def _enter(db: sqlite3.Connection, path: Path, place: Place) -> None:
    """Do what enter() does on an open file."""
    db.execute('BEGIN IMMEDIATE')
    small: dict[str, list[Any]] = {
        table: list(db.execute(f'SELECT * FROM {table} ORDER BY {ORDER[table]}'))
        for table in ('about', 'sessions', 'mounts', 'classes')}
    about = dict(small['about'])
    if about.pop('crc', None) != crc_of(about_rows(about, small)) or \
            not isinstance(about.get('settings'), str):
        raise PersemError(f'{path}: damaged (checksum of the small tables); restore it from a '
                          'copy')
    config = config_file.from_text(about['settings'], f'settings in {path}')
    about['settings'] = config_file.to_yaml(updated(config, {
        'map.crs': place.crs,
        'map.georeference': [place.east, place.north, place.up, place.yaw]}))
    db.execute('UPDATE about SET value = ? WHERE name = ?', (about['settings'], 'settings'))
    db.execute('UPDATE about SET value = ? WHERE name = ?',
               (crc_of(about_rows(about, small)), 'crc'))
    db.execute('COMMIT')


def _track(source: MapSource, stamps: NDArray[np.int64]
           ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the camera's positions (n, 3) at stamps, and where there are any."""
    order = np.argsort(source.stamps, kind='stable')
    known, places = source.stamps[order], source.positions[order]
    if len(known) < 2:
        return np.zeros((len(stamps), 3)), np.zeros(len(stamps), bool)
    after = np.searchsorted(known, stamps).clip(1, len(known) - 1)
    gap = known[after] - known[after - 1]
    within = (stamps >= known[0]) & (stamps <= known[-1]) & (gap <= GAP * 1e9)
    weight = (stamps - known[after - 1]) / np.maximum(gap, 1)
    return places[after - 1] + weight[:, None] * (places[after] - places[after - 1]), within


def _span(stamps: NDArray[np.int64]) -> str:
    """Return from when to when stamps are, in words."""
    if not len(stamps):
        return 'none'
    return f'{stamps.min() / 1e9:.2f} to {stamps.max() / 1e9:.2f} s'
