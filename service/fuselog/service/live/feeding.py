"""Samples to the filters of a service: those that are alike are fed together."""

from collections.abc import Hashable, Mapping, Sequence

from fuselog.fusion.together import MOST, Together
from fuselog.fusion.track import Share, whole
from fuselog.schemas import Messages
from fuselog.service.batch import Batch
from fuselog.service.live.member import Member
from fuselog.service.live.sources import Run


class Feeding:
    """Fuses what has come for many members, those alike together."""

    def __init__(self) -> None:
        self._together: dict[Hashable, Together] = {}

    def feed(self, batches: Mapping[Member, Sequence[Run]]) -> None:
        """Fuse samples of each member, and give the results away."""
        alike: dict[Hashable, list[Member]] = {}
        for member in batches:
            alike.setdefault(member.shape, []).append(member)
        for shape, members in alike.items():
            batch = Batch()
            spans = [member.collect(batches[member], batch) for member in members]
            messages, filters = batch.messages(), [member.filter for member in members]
            if len(members) == 1 or len(messages) > MOST:
                shares = [whole(filter.feed(messages.take(span))) for filter, span in zip(filters, spans, strict=True)]
            else:
                if shape not in self._together:
                    self._together[shape] = Together(filters[0].plan)
                shares = self._together[shape].feed(filters, messages, spans)
            for member, share, encoded in zip(members, shares, _written(members, shares), strict=True):
                member.give(share, encoded, since_ns=_since_ns(batches[member]))


def _since_ns(runs: Sequence[Run]) -> int:
    """When the oldest sample came (monotonic)."""
    _, arrivals = runs[0]
    return arrivals[0][-1]


def _written(members: Sequence[Member], shares: Sequence[Share]) -> Sequence[Messages | None]:
    """What members of one track give away, where that can be written at once; None for what each writes itself."""
    track, form = shares[0].track, members[0].form
    together = len(members) > 1 and all(share.track is track for share in shares)
    if not together or form is None or any(member.form != form for member in members):
        return [None] * len(members)
    return members[0].encode_shared(track, [share.rows for share in shares])
