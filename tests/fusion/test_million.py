"""A million random steps over all models: every P is symmetric, positive semi-definite and finite, every x finite."""

from typing import Any

import numpy as np
import pytest
from tests.fusion.setups import CONFIGURATIONS, make_plan
from tests.fusion.test_inertial import ATTITUDE, INS
from tests.fusion.test_step import assert_all_symmetric

from fuselog.fusion import Decision, Engine, Events, Plan
from fuselog.fusion.kernel.declared import MODEL_NAMES
from fuselog.fusion.kernel.tables import SAMPLE_WIDTH, Role
from fuselog.fusion.track import unpack

SECOND, STEPS, BATCHES = 1_000_000_000, 80_000, 8  # of each model
ODD = (0, 1, 997, 1_000_003, 20_000_000, 333_333_333, 2 * SECOND)  # ns from one sample to the next
CHANCES = (0.1, 0.02, 0.08, 0.2, 0.4, 0.19, 0.01)


def configuration(model: str) -> dict[str, Any]:
    """What other tests compile for the model."""
    attitude = {"state": dict.fromkeys(("roll", "pitch", "yaw"), 0.0)}
    fix = {"topic": "/fix", "fuse": [*"xyz"[: 1 if model.endswith("1d") else 3 if model.endswith("3d") else 2]]}
    inputs = {"topic": "/input", "kind": "input", "noise": {"v": 0.1, "yaw_rate": 0.1}}
    if model in CONFIGURATIONS:
        return CONFIGURATIONS[model]
    if model in ("attitude", "ins3d"):
        return {"model": model, "initial": attitude, "sensors": ATTITUDE if model == "attitude" else INS}
    if model == "brownian":
        speed = inputs | {"noise": {"v": 1.0}}
        return {"model": model, "sensors": {"speed": speed, "fix": {"topic": "/fix", "fuse": ["x"]}}}
    if model == "wall_follower":
        wall = {"topic": "/range", "fuse": ["y"], "mount": {"xyz": [0.15, 0, 0]}}
        return {"model": model, "initial": {"state": {"y": 1, "yaw": 0.2}}, "sensors": {"wheels": inputs, "wall": wall}}
    return {"model": model, "sensors": {"fix": fix}}


def random_events(plan: Plan, rng: np.random.Generator, count: int, begin_ns: int, seq: int) -> Events:
    """Any sensor at any time, values of any sign, noises over four decades, half of them correlated."""
    M, S = plan.tables.M, len(plan.sensors)
    t_ns = begin_ns + np.cumsum(rng.choice(ODD, count, p=CHANCES))
    sensor = rng.integers(0, S, count)
    z = rng.normal(0, 1, (count, M + SAMPLE_WIDTH)) * rng.choice([0.1, 1.0, 10.0], (count, 1))
    z[:, M:] = rng.normal(0, 20, (count, SAMPLE_WIDTH))
    R = np.zeros((count, M * M))
    for rank, each in enumerate(plan.sensors):
        mine, m = np.flatnonzero(sensor == rank), each.dof
        sd = 10 ** rng.uniform(-2, 2, (len(mine), m))
        A = rng.normal(size=(len(mine), m, m))
        full = A @ A.transpose(0, 2, 1) / m + 0.1 * np.eye(m)
        plain = np.broadcast_to(np.eye(m), full.shape)
        correlated = (rng.random(len(mine)) < 0.5) & (each.role == Role.MEASURES)
        full = np.where(correlated[:, np.newaxis, np.newaxis], full, plain) * sd[:, :, np.newaxis] * sd[:, np.newaxis]
        R[mine, : m * m] = (full if each.role == Role.MEASURES else full * 1e-4).reshape(-1, m * m)
    order = np.lexsort((sensor, t_ns))
    numbers = np.arange(seq, seq + count)
    return Events(t_ns[order], sensor[order], numbers, np.zeros(count, np.uint8), z[order], R[order], numbers)


@pytest.mark.parametrize("model", MODEL_NAMES)
def test_a_million_steps(model: str) -> None:
    plan = make_plan(configuration(model) | {"lag": {"window": 0}})
    engine, rng, N = Engine(plan), np.random.default_rng(len(model)), len(plan.states)
    per, t_ns, allowed = STEPS // BATCHES, SECOND, {Decision.FUSED, Decision.INVALID_UNINITIALISED}
    for batch in range(BATCHES):
        events = random_events(plan, rng, per, t_ns, batch * per)
        t_ns = int(events.t_ns[-1])
        track = engine.advance(events)
        found = {Decision(d) for d in np.unique(track.decision)}
        assert found <= allowed | ({Decision.INVALID_SINGULAR} if model == "omni3d" else set())
        known = np.isfinite(track.x)
        assert known.all() or model == "omni3d" or batch == 0
        assert not np.isinf(track.x).any()
        assert np.isfinite(track.P).all()
        assert_all_symmetric(engine)
        for row in track.P[:: max(1, N * N // 2)]:
            P = unpack(row, N)
            assert (np.diag(P) >= 0).all()
            sd = np.sqrt(np.where(np.diag(P) > 0, np.diag(P), 1.0))
            assert np.linalg.eigvalsh(P / np.outer(sd, sd))[0] > -1e-9
    assert engine.estimate.resets == 0
    assert STEPS * len(MODEL_NAMES) >= 1_000_000
