"""The filters that one configuration makes: one, or one for each name that its topics capture."""

from collections.abc import Iterator
from dataclasses import dataclass

from fuselog.fusion import Plan
from fuselog.fusion.captures import DEFAULT_ID, Captures, KeyPattern, captured, fill, id_of, patterns_of, plan_of
from fuselog.fusion.config import Problem
from fuselog.schemas import missing_extra
from fuselog.service.transport import TransportError, key_of


@dataclass(eq=False)
class Group:
    """A configuration whose topics may hold captures such as ``{robot}``.

    ``plan`` is compiled from it as it stands; a reload puts another there, for the filters that begin afterwards.
    """

    plan: Plan
    patterns: tuple[KeyPattern, ...]
    names: tuple[str, ...]  # of the captures; none where it makes one filter

    def plan_of(self, captures: Captures) -> Plan:
        """The plan of one of its filters."""
        return plan_of(self.plan, captures)

    def id_of(self, captures: Captures) -> str:
        """What the filter is called."""
        return id_of(self.plan, captures)


def make_group(plan: Plan) -> Group:
    """The group of a plan.

    Raises ``ConfigError`` for topics that cannot be keys of Zenoh, for what several filters would share, and for an
    encoding that is not installed.
    """
    places = {("sensors", sensor.name, "topic"): sensor.settings.topic for sensor in plan.sensors}
    patterns = patterns_of(plan)
    names = captured(pattern.topic for pattern in patterns)
    problems = list(_unusable(places | {("output", "estimate"): plan.config.output.estimate}))
    for place, text in ((("output", "estimate"), plan.config.output.estimate), (("id",), plan.config.id)):
        missing = [name for name in names if name not in captured([text])]
        if missing and text != DEFAULT_ID:
            problems.append(Problem(place, f"all filters would have {text!r}: put {{{missing[0]}}} into it"))
        strange = [name for name in captured([text]) if name not in names]
        if strange:
            problems.append(Problem(place, f"no topic captures {{{strange[0]}}}"))
    for place, topic in places.items():
        missing = [name for name in names if name not in captured([topic])]
        if missing and captured([topic]):
            problems.append(Problem(place, f"other topics capture {{{missing[0]}}} as well"))
    extra = missing_extra(plan.config.output.encoding)
    if extra:
        reason = f"another package writes it: pip install 'fuselog[{extra}]'"
        problems.append(Problem(("output", "encoding"), reason))
    if problems:
        raise plan.source.complain(problems)
    return Group(plan, patterns, names)


def _unusable(topics: dict[tuple[str, ...], str]) -> Iterator[Problem]:
    """The topics that cannot be keys."""
    for place, topic in topics.items():
        try:
            key_of(fill(topic, tuple((name, "x") for name in captured([topic]))))
        except TransportError as error:
            yield Problem(place, str(error))
