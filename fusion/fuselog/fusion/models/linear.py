"""A linear model of a user's own matrices."""

from collections.abc import Mapping

from fuselog.fusion.models.model import Model


def linear(states: Mapping[str, str], inputs: Mapping[str, str]) -> Model:
    """x' = F x + G u + w, the matrices being numbers of the configuration, not of the code."""
    return Model(name="linear", states=states, inputs=inputs, transition={}, noise={}, covariance={}, by_matrices=True)
