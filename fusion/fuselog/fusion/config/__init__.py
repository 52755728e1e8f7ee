"""Configuration: what it may say, and reading it with a place for every problem."""

from fuselog.fusion.config.settings import (
    AdaptSettings,
    AgeSettings,
    Config,
    FieldSettings,
    GainSettings,
    ModelSettings,
    ProcessAdaptSettings,
    RangeSettings,
    SensorSettings,
    WalkSettings,
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
    "AdaptSettings",
    "AgeSettings",
    "Config",
    "FieldSettings",
    "GainSettings",
    "ModelSettings",
    "Problem",
    "ProcessAdaptSettings",
    "RangeSettings",
    "SensorSettings",
    "Source",
    "WalkSettings",
    "WhenSettings",
    "ZenohSettings",
    "did_you_mean",
    "load_config",
    "parse_config",
    "read_source",
    "validate",
]
