"""Messages from plain data: what was given is what an independent decoder reads, and what does not fit is refused."""

from typing import Any

import pytest

from fuselog.schemas import PlainEncoder, SchemaError, definition

TREE = """\
builtin_interfaces/Time at
bool good
Leaf[] leaves
int8[3] three
string last
================================================================================
MSG: my_msgs/Leaf
uint8 small
float64 big
string[] names
uint16 next
"""
NAME = "my_msgs/msg/Tree"


@pytest.mark.parametrize(
    "leaves",
    [[], [{"small": 1, "big": -2.5, "names": ["", "ä", "long enough"], "next": 65535}, {}, {"names": ("x",)}]],
)
def test_an_independent_decoder_reads_it(leaves: list[dict[str, Any]]) -> None:
    """Alignment, nested lists, and zero for what is not given."""
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    store.register(typesys.get_types_from_msg(TREE, NAME))
    time = "builtin_interfaces/msg/Time"
    store.register(typesys.get_types_from_msg(definition(time), time))
    encoder = PlainEncoder(NAME, TREE)
    given = {"at": 7_000_000_009, "good": True, "leaves": leaves, "three": [1, -2, 3], "last": "end"}
    told = store.deserialize_cdr(encoder.encode(given), NAME)
    assert (told.at.sec, told.at.nanosec, told.good, told.last) == (7, 9, True, "end")
    assert told.three.tolist() == [1, -2, 3]
    blank = {"small": 0, "big": 0.0, "names": [], "next": 0}
    for leaf, mine in zip(told.leaves, leaves, strict=True):
        for name, value in (blank | mine).items():
            assert getattr(leaf, name) == (list(value) if name == "names" else value)


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"missing": 1}, "no field missing"),
        ({"leaves": [{"smal": 1}]}, r"no field leaves\[0\].smal"),
        ({"leaves": [{"small": 256}]}, r"leaves\[0\].small is uint8 and cannot hold 256"),
        ({"leaves": [{"small": "x"}]}, r"leaves\[0\].small is uint8"),
        ({"leaves": 3}, r"leaves is my_msgs/Leaf\[\] and cannot hold 3"),
        ({"three": [1, 2]}, r"three is int8\[3\]"),
        ({"last": 5}, "last is string and cannot hold 5"),
        ({"last": None}, "last is string"),
    ],
)
def test_what_does_not_fit_is_refused(given: dict[str, Any], reason: str) -> None:
    with pytest.raises(SchemaError, match=reason):
        PlainEncoder(NAME, TREE).encode(given)
