"""Systems of which everything is known: plants with their sensors, and the on-board controllers of closed loops."""

from fuselog.replay.scenarios.scenario import ParameterError, Quantity, Scenario, quantity

__all__ = ["ParameterError", "Quantity", "Scenario", "quantity"]
