"""From a configuration to numbers: models, sensors, gains and gates by index."""

from fuselog.fusion.plan.plan import Plan, compile_plan, load_plan
from fuselog.fusion.plan.sensors import SensorPlan

__all__ = ["Plan", "SensorPlan", "compile_plan", "load_plan"]
