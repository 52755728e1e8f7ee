"""Learning from samples that come one at a time, at rates of their own: exact where covariances are, near where not."""

import numpy as np
import pytest

from fuselog.fusion.design import DesignError, Innovations, make_step, periodic_riccati, sensor_corrections
from fuselog.fusion.design.matrices import Floats

F = np.array([[1, 0.1], [0, 1]])
Q = np.diag([1e-4, 4e-4])
H = {0: np.array([[1.0, 0.5]]), 1: np.array([[0.0, 1.0]])}
R = {0: np.array([[4e-4]]), 1: np.array([[0.01]])}
START = {0: np.array([[0.3], [0.0]]), 1: np.array([[0.0], [0.3]])}
PERIOD = [(0, 0), (1, 0), (1, 1), (0, 1), (1, 1)]  # sensor, and how many steps of F lead to it


def filtered(G: dict[int, Floats], N: int, seed: int, units: dict[int, float] | None = None) -> Innovations:
    """N periods of a simulated system and the innovations that these gains leave."""
    rng, root = np.random.default_rng(seed), np.linalg.cholesky(Q)
    units = units or {0: 1.0, 1: 1.0}
    x, estimate = np.zeros(2), np.zeros(2)
    sensor = np.array([s for s, _ in PERIOD] * N)
    move = np.array([m for _, m in PERIOD] * N)
    nu = np.zeros((len(sensor), 1))
    scaled = {s: H[s] * units[s] for s in H}
    for k, (s, m) in enumerate(zip(sensor.tolist(), move.tolist(), strict=True)):
        for _ in range(m):
            x, estimate = F @ x + root @ rng.normal(size=2), F @ estimate
        z = scaled[s] @ x + units[s] * np.sqrt(R[s][0]) * rng.normal(size=1)
        nu[k] = z - scaled[s] @ estimate
        estimate = estimate + G[s] @ nu[k]
    return Innovations(sensor=sensor, move=move, nu=nu, F=np.stack([np.eye(2), F]), H=scaled, G=G)


def steady() -> dict[int, Floats]:
    """The mean optimal gain of each sensor in a period."""
    steps = [make_step(F if m else np.eye(2), Q * m, H[s], R[s]) for s, m in PERIOD]
    found = periodic_riccati(steps)
    return {s: np.mean([one.G for (r, _), one in zip(PERIOD, found, strict=True) if r == s], axis=0) for s in H}


def test_two_sensors_at_rates_of_their_own_learn_the_gains_of_their_period() -> None:
    best, G = steady(), START
    for _ in range(4):
        corrections = sensor_corrections(filtered(G, 3000, 1), 15)
        G = {s: G[s] + corrections[s] for s in G}
    for s in best:
        assert np.linalg.norm(G[s] - best[s]) < 0.08 * np.linalg.norm(best[s])
        assert np.linalg.norm(START[s] - best[s]) > 0.5 * np.linalg.norm(best[s])


def test_units_of_sensors_do_not_matter() -> None:
    units = {0: 1000.0, 1: 1e-3}
    plain = sensor_corrections(filtered(START, 500, 2), 10)
    other = sensor_corrections(filtered({s: START[s] / units[s] for s in START}, 500, 2, units), 10)
    for s in plain:
        assert other[s] * units[s] == pytest.approx(plain[s], rel=1e-6)


def test_what_innovations_cannot_show_stays() -> None:
    """A second state that no sensor sees, and that nothing depends on, gets no correction."""
    told = filtered(START, 500, 3)
    F3 = np.zeros((2, 3, 3))
    F3[:, :2, :2], F3[:, 2, 2] = told.F, 1.0
    wider = Innovations(
        sensor=told.sensor,
        move=told.move,
        nu=told.nu,
        F=F3,
        H={s: np.hstack([h, [[0.0]]]) for s, h in told.H.items()},
        G={s: np.vstack([g, [[0.0]]]) for s, g in told.G.items()},
    )
    corrections, plain = sensor_corrections(wider, 10), sensor_corrections(told, 10)
    for s, found in corrections.items():
        assert found[2] == 0
        assert found[:2] == pytest.approx(plain[s], rel=1e-9)


def test_too_few_or_dependent() -> None:
    told = filtered(START, 2, 4)
    with pytest.raises(DesignError, match="10 innovations are too few for 10 lags"):
        sensor_corrections(told, 10)
    told.nu[told.sensor == 1] = 0
    with pytest.raises(DesignError, match="linearly dependent, or too few"):
        sensor_corrections(told, 3)
