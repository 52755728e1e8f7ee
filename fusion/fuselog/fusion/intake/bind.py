"""From decoded columns to measured numbers: orientation, mounting, datum, scale and covariance, sample by sample.

One kernel does it for any sensor, row by row, so that a batch of one gives the same bytes as a batch of a million.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.atmosphere import height, height_slope
from fuselog.fusion.events import Decision, Events
from fuselog.fusion.geodesy import enu
from fuselog.fusion.intake.mounts import Mount
from fuselog.fusion.kernel.rotations import (
    Quaternion,
    put_matrix,
    quaternion_from_rpy,
    quaternion_product,
    rpy_from_quaternion,
)
from fuselog.fusion.kernel.tables import SAMPLE_WIDTH, Role
from fuselog.fusion.plan import SensorPlan
from fuselog.fusion.plan.readings import BEACON, FIELD, Part, Shape
from fuselog.schemas.compiled import kernel, leaf

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Row = Any  # a row of Floats, inside kernels, where indexing gives a number

VECTOR, ORIENTATION, GEODETIC = int(Shape.VECTOR), int(Shape.ORIENTATION), int(Shape.GEODETIC)
PRESSURE, ZERO = int(Shape.PRESSURE), int(Shape.ZERO)
GOOD, NAN, CLOCK, COVARIANCE = (
    int(d) for d in (Decision.FUSED, Decision.INVALID_NAN, Decision.INVALID_CLOCK, Decision.INVALID_COVARIANCE)
)


class Recipe(NamedTuple):
    """How the columns of one sensor become m numbers: parts of 1 or 3 quantities, of which some are picked.

    Columns are numbered as ``fields`` of the binder; -1 stands for none.
    """

    shape: Ints  # (parts,) of Shape
    column: Ints  # (parts,) where the part's numbers begin
    slot: Ints  # (parts,) where its quantities begin
    size: Ints  # (parts,) how many quantities
    world: Ints  # (parts,) whether the covariance of an attitude is to be turned from the world's axes to the body's
    curved: bool  # whether there is a covariance to convert even where the sensor's axes are the body's
    covariance: Ints  # (slots, slots) column of each entry
    pick: Any  # (m,) slot of each fused number
    entry: Ints  # (entries, 2) the places (i, j <= i) of R that can differ from 0
    extra: Ints  # (SAMPLE_WIDTH,) slots of what comes with a sample
    status: Ints  # columns of which each must not be negative
    fixed: Floats  # (m, m) covariance that takes the place of the message's; NaN to keep it
    variance: Floats  # (m,) the same for one number
    floor: Floats  # (m,) least variance
    scale: Floats  # (m,)
    offset: Floats  # (m,)
    inflate: float  # factor on the message's variances


@dataclass(frozen=True, slots=True)
class Binder:
    """The fields that a sensor needs of a message type, and what is made of them."""

    fields: tuple[str, ...]
    recipe: Recipe
    needs_datum: bool
    needs_reference: bool  # of a pressure

    def bind(
        self, values: Floats, events: Events, rows: Ints, mount: Mount, datum: Floats, reference: float = math.nan
    ) -> None:
        """Fill z and R of these blank rows of the events, whose stamps and faults are set; the others' stay untouched.

        A row that cannot be used gets its fault.
        """
        turn = (mount.turned, mount.matrix, mount.quaternion)
        bind_rows(self.recipe, values, rows, events.t_ns, events.fault, *turn, datum, reference, events.z, events.R)


def make_binder(sensor: SensorPlan, parts: Sequence[Part]) -> Binder:
    """The binder of a sensor whose numbers are in these parts of its messages."""
    fields: list[str] = []
    names = [name for part in parts for name in part.names]
    columns, slots, slot = list[int](), list[int](), 0
    for part in parts:
        columns.append(len(fields))
        slots.append(slot)
        fields += part.fields
        slot += len(part.names)
    covariance = np.full((len(names), len(names)), -1, np.int64)
    for part, at in zip(parts, slots, strict=True):
        for other, to in zip(parts, slots, strict=True):
            _place_covariance(covariance, fields, (part, at), (other, to))
    settings = sensor.settings
    with_sample = {"beacon_range": BEACON, "magnetometer": FIELD}.get(settings.kind, ())
    extra = [names.index(name) for name in with_sample] or [-1] * SAMPLE_WIDTH
    scale = np.array([settings.scale.get(name, 1.0) for name in sensor.names])
    offset = np.array([settings.offset.get(name, 0.0) for name in sensor.names])
    if settings.kind == "magnetometer":  # the field comes with the sample; its azimuth, from east, is what is known
        scale, offset = np.zeros(1), np.array([math.pi / 2 - settings.declination])
    status = [part.status for part in parts if part.status is not None]
    fields += status
    world = [sensor.turn >= 0 and part.shape == Shape.ORIENTATION and _is_fixed(part) for part in parts]
    pick = [names.index(name) for name in sensor.names]
    fixed = np.full((len(pick), len(pick)), math.nan)
    if settings.R is not None and sensor.R is not None:
        fixed = sensor.R
    pairs = [(i, j) for i in range(len(pick)) for j in range(i + 1)]
    entry = [(i, j) for i, j in pairs if i == j or covariance[pick[i], pick[j]] >= 0 or settings.R is not None]
    recipe = Recipe(
        shape=np.array([part.shape for part in parts], np.int64),
        column=np.array(columns, np.int64),
        slot=np.array(slots, np.int64),
        size=np.array([len(part.names) for part in parts], np.int64),
        world=np.array(world, np.int64),
        curved=any(world) or any(part.shape == Shape.PRESSURE for part in parts),
        covariance=covariance,
        pick=np.array(pick, np.int64),
        entry=np.array(entry, np.int64),
        extra=np.array(extra, np.int64),
        status=np.arange(len(fields) - len(status), len(fields)),
        fixed=fixed,
        variance=np.array([settings.noise.get(name, math.nan) ** 2 for name in sensor.names]),
        floor=np.array([settings.noise_floor.get(name, 0.0) ** 2 for name in sensor.names]),
        scale=scale,
        offset=offset,
        inflate=settings.noise_scale**2,
    )
    shapes = {part.shape for part in parts}
    return Binder(tuple(fields), recipe, Shape.GEODETIC in shapes, Shape.PRESSURE in shapes)


def _is_fixed(part: Part) -> bool:
    return part.covariance is not None and part.covariance.fixed


def without_noise(sensor: SensorPlan, parts: Sequence[Part]) -> list[str]:
    """The fused numbers whose noise nobody gives: neither the message nor the configuration."""
    covered = {name for part in parts if part.covariance is not None for name in part.names}
    covered = set[str]() if sensor.role != Role.MEASURES else covered
    covered |= {*sensor.names} if sensor.settings.R is not None else set()
    return [name for name in sensor.names if name not in covered and name not in sensor.settings.noise]


def _place_covariance(covariance: Ints, fields: list[str], rows: tuple[Part, int], columns: tuple[Part, int]) -> None:
    """Columns for the covariance between two parts, when they stand in the same matrix."""
    (part, at), (other, to) = rows, columns
    a, b = part.covariance, other.covariance
    if a is None or b is None or a.path != b.path:
        return
    for i in range(len(part.names)):
        for j in range(len(other.names)):
            entry = f"{a.path}[{(a.row + i) * a.order + b.row + j}]" if a.order else a.path
            covariance[at + i, to + j] = len(fields)
            fields.append(entry)


@kernel
def bind_rows(
    recipe: Recipe,
    values: Row,
    rows: Ints,
    t_ns: Row,
    fault: NDArray[np.uint8],
    turned: bool,
    matrix: Floats,
    quaternion: Floats,
    datum: Floats,
    reference: float,
    z: Row,
    R: Row,
) -> None:
    """``Binder.bind``: row ``rows[n]`` of z and R from ``values[n]``."""
    slots, m, M = len(recipe.covariance), len(recipe.pick), z.shape[1] - SAMPLE_WIDTH
    full: Row = np.zeros(slots)
    C: Row = np.zeros((slots, slots))
    half: Row = np.zeros((slots, slots))
    T: Row = np.zeros((3, 3))
    converted = turned or recipe.curved
    L = np.zeros(m * m)
    undo = (-quaternion[0], -quaternion[1], -quaternion[2], quaternion[3])
    for n in range(len(rows)):
        row = rows[n]
        if fault[row] != GOOD:
            continue
        for part in range(len(recipe.shape)):
            read_part(recipe, values[n], part, matrix, undo, turned, datum, reference, full)
        if converted:
            gather(recipe, values[n], C)
            convert(recipe, values[n], full, C, half, matrix, turned, T)
        for i in range(m):
            z[row, i] = full[recipe.pick[i]] * recipe.scale[i] + recipe.offset[i]
        for place in range(len(recipe.entry)):
            i, j = recipe.entry[place, 0], recipe.entry[place, 1]
            a, b = recipe.pick[i], recipe.pick[j]
            if converted:
                entry = 0.5 * (C[a, b] + C[b, a])
            else:
                entry = 0.5 * (stated(recipe, values[n], a, b) + stated(recipe, values[n], b, a))
            R[row, i * m + j] = R[row, j * m + i] = noise(recipe, i, j, entry)
        for i in range(SAMPLE_WIDTH):
            if recipe.extra[i] >= 0:
                z[row, M + i] = full[recipe.extra[i]]
        for column in recipe.status:
            if not values[n, column] >= 0.0:
                z[row, 0] = math.nan
        fault[row] = judge(recipe, t_ns[row], z[row], R[row], L)


@leaf
def read_part(
    recipe: Recipe,
    row: Row,
    part: int,
    matrix: Row,
    undo: Quaternion,
    turned: bool,
    datum: Row,
    reference: float,
    full: Row,
) -> None:
    """The quantities of one part, in body axes."""
    c, s = recipe.column[part], recipe.slot[part]
    if recipe.shape[part] == ORIENTATION:
        x, y, z, w = row[c], row[c + 1], row[c + 2], row[c + 3]
        if not 0.0 < x * x + y * y + z * z + w * w < math.inf:
            x = math.nan
        if turned:
            x, y, z, w = quaternion_product((x, y, z, w), undo)
        full[s], full[s + 1], full[s + 2] = rpy_from_quaternion(x, y, z, w)
    elif recipe.shape[part] == GEODETIC:
        full[s], full[s + 1], full[s + 2] = enu(datum, row[c], row[c + 1], row[c + 2])
    elif recipe.shape[part] == PRESSURE:
        full[s] = height(row[c]) - height(reference)
    elif recipe.shape[part] == ZERO:
        for i in range(recipe.size[part]):
            full[s + i] = 0.0
    elif recipe.shape[part] == VECTOR and turned:
        for i in range(3):
            full[s + i] = matrix[i, 0] * row[c] + matrix[i, 1] * row[c + 1] + matrix[i, 2] * row[c + 2]
    else:
        for i in range(recipe.size[part]):
            full[s + i] = row[c + i]


@leaf
def gather(recipe: Recipe, row: Row, C: Row) -> None:
    """The covariance of all quantities as the message has it; 0 where it has none."""
    for i in range(len(C)):
        for j in range(len(C)):
            C[i, j] = stated(recipe, row, i, j)


@leaf
def stated(recipe: Recipe, row: Row, i: int, j: int) -> float:
    """The covariance of two quantities as the message states it; 0 where it does not."""
    column = recipe.covariance[i, j]
    return row[column] if column >= 0 else 0.0


@leaf
def convert(recipe: Recipe, row: Row, full: Row, C: Row, half: Row, matrix: Row, turned: bool, T: Row) -> None:
    """C = J C J', where J makes the message's errors those of the quantities, part by part: rows, then columns."""
    for part in range(len(recipe.shape)):
        s = recipe.slot[part]
        size = put_change(recipe, row, full, part, matrix, turned, T)
        for j in range(len(C) if size else 0):
            for i in range(size):
                half[s + i, j] = 0.0
                for k in range(size):
                    half[s + i, j] += T[i, k] * C[s + k, j]
            for i in range(size):
                C[s + i, j] = half[s + i, j]
    for part in range(len(recipe.shape)):
        s = recipe.slot[part]
        size = put_change(recipe, row, full, part, matrix, turned, T)
        for i in range(len(C) if size else 0):
            for j in range(size):
                half[i, s + j] = 0.0
                for k in range(size):
                    half[i, s + j] += C[i, s + k] * T[j, k]
            for j in range(size):
                C[i, s + j] = half[i, s + j]


@leaf
def put_change(recipe: Recipe, row: Row, full: Row, part: int, matrix: Row, turned: bool, T: Row) -> int:
    """How the errors of one part's quantities follow from the message's, into T; returns its order, 0 for the same.

    Vectors and attitudes turn with the mount, an attitude's small turns about the world's axes to those about the
    body's.
    """
    s = recipe.slot[part]
    if recipe.world[part]:
        x, y, z, w = quaternion_from_rpy(full[s], full[s + 1], full[s + 2])
        put_matrix((-x, -y, -z, w), T)
        return 3
    if recipe.shape[part] == PRESSURE:
        T[0, 0] = height_slope(row[recipe.column[part]])
        return 1
    if turned and (recipe.shape[part] == VECTOR or recipe.shape[part] == ORIENTATION):
        for i in range(3):
            for j in range(3):
                T[i, j] = matrix[i, j]
        return 3
    return 0


@leaf
def noise(recipe: Recipe, i: int, j: int, entry: float) -> float:
    """One entry of R: the configured variance, or the message's, inflated, floored and scaled with the value."""
    if not math.isnan(recipe.fixed[i, j]):
        return recipe.fixed[i, j]
    if i == j:
        own = recipe.variance[i]
        variance = entry * recipe.inflate if math.isnan(own) else own
        if 0.0 <= variance < recipe.floor[i]:
            variance = recipe.floor[i]
        return variance * recipe.scale[i] ** 2 if math.isnan(own) else variance
    if math.isnan(recipe.variance[i]) and math.isnan(recipe.variance[j]):
        return entry * recipe.inflate * recipe.scale[i] * recipe.scale[j]
    return 0.0


@leaf
def judge(recipe: Recipe, t: int, z: Row, R: Row, L: Row) -> int:
    """Whether a sample can be used: a stamp after 1970, finite numbers, a positive definite covariance."""
    if t <= 0:
        return CLOCK
    for i in range(len(z)):
        if not math.isfinite(z[i]):
            return NAN
    m, coupled, positive = len(recipe.pick), False, True
    for i in range(m):
        positive &= 0.0 < R[i * m + i] < math.inf
    for place in range(len(recipe.entry)):
        i, j = recipe.entry[place, 0], recipe.entry[place, 1]
        coupled |= i != j and R[i * m + j] != 0.0
    return GOOD if positive and (not coupled or positive_definite(R, L, m)) else COVARIANCE


@leaf
def positive_definite(R: Row, L: Row, m: int) -> bool:
    """By the pivots of its Cholesky factor, left in L."""
    for i in range(m):
        for j in range(i + 1):
            total = R[i * m + j]
            for k in range(j):
                total -= L[i * m + k] * L[j * m + k]
            if i != j:
                L[i * m + j] = total / L[j * m + j]
            elif 0.0 < total < math.inf:
                L[i * m + i] = math.sqrt(total)
            else:
                return False
    return True
