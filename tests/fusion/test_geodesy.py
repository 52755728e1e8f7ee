"""Geodesy, rotations and mounts against pymap3d and scipy."""

from itertools import pairwise

import numpy as np
import pymap3d
import pytest
from scipy.spatial.transform import Rotation
from tests.fusion.from_python import from_python

from fuselog.fusion.geodesy import enu_from_geodetic
from fuselog.fusion.intake.mounts import Mount, StaticTransforms
from fuselog.fusion.kernel import rotations

rpy_from_quaternion = from_python(rotations.rpy_from_quaternion)
quaternion_product = from_python(rotations.quaternion_product)
RNG = np.random.default_rng(6)


@pytest.mark.parametrize("latitude", [-89.9, -45.0, 0.0, 0.001, 51.05, 89.9])
@pytest.mark.parametrize("longitude", [-179.999, -13.7, 0.0, 90.0, 179.999])
def test_east_north_up(latitude: float, longitude: float) -> None:
    datum = np.array([latitude, longitude, 120.0])
    points = datum + RNG.uniform(-0.05, 0.05, (50, 3)) * [1, 1, 4000]
    ours = enu_from_geodetic(datum, points)
    theirs = np.transpose(pymap3d.geodetic2enu(*points.T, *datum))
    assert np.abs(ours - theirs).max() < 5e-9  # two roundings of 6.4e6 m
    assert np.abs(enu_from_geodetic(datum, datum[None])).max() == 0.0


def test_a_fix_across_the_date_line_is_near() -> None:
    datum = np.array([10.0, 179.9999, 0.0])
    assert np.linalg.norm(enu_from_geodetic(datum, np.array([[10.0, -179.9999, 0.0]]))) < 30


def test_roll_pitch_yaw_both_ways() -> None:
    quaternions = RNG.normal(size=(500, 4))
    for x, y, z, w in quaternions:
        ours = rpy_from_quaternion(x, y, z, w)  # of any length
        theirs = Rotation.from_quat([x, y, z, w]).as_euler("ZYX")[::-1]
        assert ours == pytest.approx(theirs, abs=1e-7)
    rpy = RNG.uniform([-3.1, -1.5, -3.1], [3.1, 1.5, 3.1], (500, 3))
    ours = rotations.quaternions_from_rpy(rpy)
    theirs = Rotation.from_euler("ZYX", rpy[:, ::-1]).as_quat()
    assert np.abs(np.abs(np.sum(ours * theirs, axis=1)) - 1).max() < 1e-14
    for quaternion, angles in zip(ours, rpy, strict=True):
        assert rpy_from_quaternion(*quaternion) == pytest.approx(angles, abs=1e-9)


def test_straight_up_is_no_domain_error() -> None:
    for pitch in (np.pi / 2, -np.pi / 2):
        for roll, yaw in RNG.uniform(-3, 3, (50, 2)):
            found = rpy_from_quaternion(*rotations.quaternions_from_rpy(np.array([[roll, pitch, yaw]]))[0])
            assert np.isfinite(found).all()
            assert found[1] == pytest.approx(pitch, abs=1e-7)


def test_products_and_matrices() -> None:
    for _ in range(100):
        p, q = RNG.normal(size=(2, 4))
        expected = Rotation.from_quat(p) * Rotation.from_quat(q)
        product = np.array(quaternion_product(tuple(p), tuple(q)))
        assert Rotation.from_quat(product).as_matrix() == pytest.approx(expected.as_matrix(), abs=1e-13)
        assert rotations.matrix_from_quaternion(p) == pytest.approx(Rotation.from_quat(p).as_matrix(), abs=1e-14)


def random_mount() -> tuple[Mount, np.ndarray]:
    turn, lever = Rotation.from_quat(RNG.normal(size=4)), RNG.normal(size=3)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn.as_matrix(), lever
    return Mount(lever, turn.as_quat() * RNG.uniform(0.5, 2)), matrix


def test_static_transforms_chain_like_matrices() -> None:
    transforms, matrix = StaticTransforms(), np.eye(4)
    frames = ["base_link", "mast", "head", "imu_link"]
    for parent, child in pairwise(frames):
        mount, step = random_mount()
        transforms.parents[child] = parent, mount
        matrix = matrix @ step
    found = transforms.find("/base_link", "/imu_link")
    assert found is not None
    assert found.lever == pytest.approx(matrix[:3, 3], abs=1e-13)
    assert found.matrix == pytest.approx(matrix[:3, :3], abs=1e-13)
    assert transforms.find("imu_link", "base_link") is None
    assert transforms.find("base_link", "camera") is None
    itself = transforms.find("base_link", "base_link")
    assert itself is not None
    assert not itself.turned


def test_a_loop_of_transforms_ends() -> None:
    transforms = StaticTransforms()
    transforms.parents |= {"a": ("b", random_mount()[0]), "b": ("a", random_mount()[0])}
    assert transforms.find("base_link", "a") is None
