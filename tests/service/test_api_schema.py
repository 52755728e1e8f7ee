"""The interface against its own description: whatever that allows and forbids is asked, by both roles."""

import pytest
import schemathesis
from hypothesis import HealthCheck, settings
from schemathesis import checks

from .conftest import ACCESS, CONTROL, READ, Robot, app_of, bearer, positions

_EXCLUDED = [
    # What is valid by form can still be wrong for this filter (a state it has not): 422 with the place, as documented.
    checks.positive_data_acceptance,
    # It leaves out the token that it knows of, not the header here; test_api_security.py asks without.
    checks.ignored_auth,
]


def _driving() -> Robot:
    robot = Robot()
    robot.feed(positions([i / 10 for i in range(30)], [i / 10 for i in range(30)]))
    return robot


# The stream never ends; it has tests of its own.
SCHEMA = schemathesis.openapi.from_asgi("/openapi.json", app_of(_driving(), access=ACCESS, hosts=None)).exclude(
    path="/api/v1/stream"
)


@SCHEMA.parametrize()
@settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@pytest.mark.parametrize("secret", [READ, CONTROL], ids=["read", "control"])
def test_what_is_described_is_what_is_done(case: schemathesis.Case, secret: str) -> None:
    """No 5xx, no status, type or content that the description has not, the right Allow at 405."""
    case.call_and_validate(headers=bearer(secret), excluded_checks=_EXCLUDED)
