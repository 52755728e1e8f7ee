"""The filters that one configuration makes: one, or one for each name that its topics capture."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

from fuselog.fusion import Plan
from fuselog.fusion.captures import DEFAULT_ID, Captures, KeyPattern, captured, fill, id_of, patterns_of, plan_of
from fuselog.fusion.config import Problem
from fuselog.fusion.intake import same_topic
from fuselog.schemas import missing_extra
from fuselog.service.ros_keys import ros_key, ros_subscription
from fuselog.service.transport import TransportError, key_of


@dataclass(eq=False)
class Group:
    """A configuration whose topics may hold captures such as ``{robot}``.

    ``plan`` is compiled from it as it stands; a reload puts another there, for the filters that begin afterwards.
    """

    plan: Plan
    patterns: tuple[KeyPattern, ...]
    names: tuple[str, ...]  # of the captures; none where it makes one filter

    @property
    def ros_domain(self) -> int | None:
        """The domain of ROS 2 that its topics are in, too; None for none."""
        ros = self.plan.config.zenoh.ros
        return None if ros is None else ros.domain

    @property
    def subscriptions(self) -> list["Subscription"]:
        """What it reads."""
        domains = [None] if self.ros_domain is None else [None, self.ros_domain]
        return [Subscription(self, pattern, domain) for pattern in self.patterns for domain in domains]

    def plan_of(self, captures: Captures) -> Plan:
        """The plan of one of its filters."""
        return plan_of(self.plan, captures)

    def id_of(self, captures: Captures) -> str:
        """What the filter is called."""
        return id_of(self.plan, captures)


@dataclass(frozen=True)
class Subscription:
    """One topic of a group, which may capture names: its plain keys, or those that it has in a domain of ROS 2."""

    group: Group
    pattern: KeyPattern
    domain: int | None

    @cached_property
    def expression(self) -> str:
        """All its keys, in Zenoh's own form."""
        plain = self.pattern.expression
        return plain if self.domain is None else ros_subscription(plain, None, domain=self.domain)

    def plain(self, key: str) -> str:
        """A key of it as the filters know it."""
        ros = None if self.domain is None else ros_key(key)
        return key if ros is None else same_topic(ros.topic)


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
    if plan.config.zenoh.ros is not None and plan.config.output.encoding != "cdr":
        problems.append(Problem(("output", "encoding"), "ROS 2 (zenoh: ros) reads nothing but cdr"))
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
