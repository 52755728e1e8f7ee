"""Configuration: what it may say, and reading it with a place for every problem."""

from fuselog.fusion.config.settings import Config, GainSettings, RangeSettings, SensorSettings, ZenohSettings
from fuselog.fusion.config.source import (
    Problem,
    Source,
    did_you_mean,
    load_config,
    parse_config,
    read_source,
    validate,
)

__all__ = [
    "Config",
    "GainSettings",
    "Problem",
    "RangeSettings",
    "SensorSettings",
    "Source",
    "ZenohSettings",
    "did_you_mean",
    "load_config",
    "parse_config",
    "read_source",
    "validate",
]
