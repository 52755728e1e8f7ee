"""Configuration: what it may say, and reading it with a place for every problem."""

from fuselog.fusion.config.settings import (
    AgeSettings,
    Config,
    GainSettings,
    RangeSettings,
    SensorSettings,
    WhenSettings,
    ZenohSettings,
)
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
    "AgeSettings",
    "Config",
    "GainSettings",
    "Problem",
    "RangeSettings",
    "SensorSettings",
    "Source",
    "WhenSettings",
    "ZenohSettings",
    "did_you_mean",
    "load_config",
    "parse_config",
    "read_source",
    "validate",
]
