"""Gains designed ahead: steady, fixed and learned ones, and the checks that they need. Pure functions of matrices."""

from fuselog.fusion.design.discretize import Discrete, van_loan
from fuselog.fusion.design.fixed import (
    covariances,
    lag_one,
    lyapunov,
    optimality_ratio,
    period_map,
    periodic_lyapunov,
    spectral_radius,
)
from fuselog.fusion.design.kappa import direct_rows, kappa_gain
from fuselog.fusion.design.learn import (
    Learned,
    gain_correction,
    gain_mismatch,
    innovation_covariances,
    learn_gain,
    prediction_error,
    replay_innovations,
    three_cornered_hat,
)
from fuselog.fusion.design.learn_sensors import Innovations, sensor_corrections
from fuselog.fusion.design.matrices import DesignError
from fuselog.fusion.design.modes import (
    Mode,
    NoiselessError,
    UndetectableError,
    UnstableError,
    check_detectable,
    check_stable,
    frozen_states,
    undetectable_modes,
)
from fuselog.fusion.design.steady import dare, periodic_riccati
from fuselog.fusion.design.steps import Corrected, Step, make_step
from fuselog.fusion.design.weights import (
    MissingRule,
    absorb_gain,
    effective_variance,
    fixed_weights,
    inverse_variance,
    present_weights,
    sequential_weights,
    state_gain,
    steady_scalar_gain,
)

__all__ = [
    "Corrected",
    "DesignError",
    "Discrete",
    "Innovations",
    "Learned",
    "MissingRule",
    "Mode",
    "NoiselessError",
    "Step",
    "UndetectableError",
    "UnstableError",
    "absorb_gain",
    "check_detectable",
    "check_stable",
    "covariances",
    "dare",
    "direct_rows",
    "effective_variance",
    "fixed_weights",
    "frozen_states",
    "gain_correction",
    "gain_mismatch",
    "innovation_covariances",
    "inverse_variance",
    "kappa_gain",
    "lag_one",
    "learn_gain",
    "lyapunov",
    "make_step",
    "optimality_ratio",
    "period_map",
    "periodic_lyapunov",
    "periodic_riccati",
    "prediction_error",
    "present_weights",
    "replay_innovations",
    "sensor_corrections",
    "sequential_weights",
    "spectral_radius",
    "state_gain",
    "steady_scalar_gain",
    "three_cornered_hat",
    "undetectable_modes",
    "van_loan",
]
