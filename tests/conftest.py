"""What every test runs with."""

from hypothesis import HealthCheck, settings

# a machine that does other things as well may stand still for a second while an example is made
settings.register_profile("shared machine", suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("shared machine")
