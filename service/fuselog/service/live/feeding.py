"""Samples to the filters of a service: those that are alike are fed together."""

from collections.abc import Hashable, Mapping, Sequence

from fuselog.fusion.together import MOST, Together
from fuselog.service.batch import Batch
from fuselog.service.live.member import Member
from fuselog.service.live.sources import Numbered


class Feeding:
    """Fuses what has come for many members, those alike together."""

    def __init__(self) -> None:
        self._together: dict[Hashable, Together] = {}

    def feed(self, batches: Mapping[Member, Sequence[Numbered]]) -> None:
        """Fuse samples of each member, and give the results away."""
        alike: dict[Hashable, list[Member]] = {}
        for member in batches:
            alike.setdefault(member.shape, []).append(member)
        for shape, members in alike.items():
            batch = Batch()
            spans = [member.collect(batches[member], batch) for member in members]
            messages, filters = batch.messages(), [member.filter for member in members]
            if len(members) == 1 or len(messages) > MOST:
                tracks = [filter.feed(messages.take(span)) for filter, span in zip(filters, spans, strict=True)]
            else:
                if shape not in self._together:
                    self._together[shape] = Together(filters[0].plan)
                tracks = self._together[shape].feed(filters, messages, spans)
            for member, track in zip(members, tracks, strict=True):
                member.give(track, since_ns=batches[member][0].since_ns)
