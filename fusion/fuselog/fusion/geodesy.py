"""Geodetic coordinates to a local frame, one sample at a time, so that batches of any length give the same bytes."""

import math

import numpy as np
from numpy.typing import NDArray

from fuselog.schemas.compiled import inline, kernel

A = 6378137.0  # m, WGS 84 equatorial radius
F = 1 / 298.257223563  # WGS 84 flattening
E2 = F * (2 - F)


@inline
def ecef(latitude: float, longitude: float, altitude: float) -> tuple[float, float, float]:
    """Earth-centred coordinates (m) of a point given in degrees and metres above the WGS 84 ellipsoid."""
    phi, lam = math.radians(latitude), math.radians(longitude)
    normal = A / math.sqrt(1 - E2 * math.sin(phi) ** 2)
    across = (normal + altitude) * math.cos(phi)
    return across * math.cos(lam), across * math.sin(lam), (normal * (1 - E2) + altitude) * math.sin(phi)


@inline
def enu(datum: NDArray[np.float64], latitude: float, longitude: float, altitude: float) -> tuple[float, float, float]:
    """East, north, up (m) from ``datum`` = (latitude, longitude, altitude)."""
    ox, oy, oz = ecef(datum[0], datum[1], datum[2])
    px, py, pz = ecef(latitude, longitude, altitude)
    dx, dy, dz = px - ox, py - oy, pz - oz
    phi, lam = math.radians(datum[0]), math.radians(datum[1])
    sin_phi, cos_phi, sin_lam, cos_lam = math.sin(phi), math.cos(phi), math.sin(lam), math.cos(lam)
    along = cos_lam * dx + sin_lam * dy
    return -sin_lam * dx + cos_lam * dy, -sin_phi * along + cos_phi * dz, cos_phi * along + sin_phi * dz


@kernel
def enu_from_geodetic(datum: NDArray[np.float64], geodetic: NDArray[np.float64]) -> NDArray[np.float64]:
    """East, north, up (n, 3) in m of ``geodetic`` (n, 3): latitude, longitude in degrees, altitude in m."""
    out = np.empty_like(geodetic)
    for i in range(len(geodetic)):
        out[i, 0], out[i, 1], out[i, 2] = enu(datum, geodetic[i, 0], geodetic[i, 1], geodetic[i, 2])
    return out
