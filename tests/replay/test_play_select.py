"""What a player publishes: chosen topics, their names, and moments as people write them."""

from pathlib import Path

import pytest

from fuselog.replay import open_log
from fuselog.replay.play import CommandError, parse_moment, playable, remap
from fuselog.schemas import LogError

from .players import S, write


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Two cameras, static transforms, and an output of an earlier run."""
    rows = [("/left/image", 0), ("/right/image", 0), ("/tf_static", 0), ("/fused", 1)]
    return write(tmp_path / "log.mcap", rows, types={"/fused": "fuselog_msgs/msg/Estimate"})


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, ["/left/image", "/right/image", "/tf_static"]),
        ({"topics": ["/left/image"]}, ["/left/image"]),
        ({"regex": ".*/image"}, ["/left/image", "/right/image"]),
        ({"regex": ".*/image", "topics": ["/tf_static"]}, ["/left/image", "/right/image", "/tf_static"]),
        ({"exclude": ["/tf_static"], "exclude_regex": "/left.*"}, ["/right/image"]),
        ({"regex": "/(left|right)/image", "exclude": ["/left/image"]}, ["/right/image"]),
        ({"topics": ["/fused"]}, []),
        ({"exclude_regex": ".*"}, []),
    ],
)
def test_which_topics(log: Path, options: dict[str, str], expected: list[str]) -> None:
    """Chosen and left out, by name and by pattern; results of an earlier run are never played."""
    with open_log(log) as opened:
        assert [channel.topic for channel in playable(opened, **options)] == expected


@pytest.mark.parametrize(
    ("options", "kind", "message"),
    [
        ({"topics": ["/c"]}, LogError, "no topic '/c'; it has /left/image, /right/image, /tf_static, /fused"),
        ({"exclude": ["/c"]}, LogError, "no topic '/c'"),
        ({"regex": "image"}, LogError, "no topic matches 'image'; it has /left/image"),
        ({"regex": "["}, CommandError, r"'\[' is no regular expression: unterminated"),
    ],
)
def test_topics_that_are_not_there(log: Path, options: dict[str, str], kind: type[Exception], message: str) -> None:
    """The error names those that are."""
    with open_log(log) as opened, pytest.raises(kind, match=message):
        playable(opened, **options)


def test_other_names(log: Path) -> None:
    """Names can be given, also in exchange; never one name to two."""
    with open_log(log) as opened:
        channels = playable(opened)
    assert remap(channels, ["/left/image:=/a"]) == {
        "/left/image": "/a",
        "/right/image": "/right/image",
        "/tf_static": "/tf_static",
    }
    swapped = remap(channels, ["/left/image:=/right/image", "/right/image:=/left/image"])
    assert (swapped["/left/image"], swapped["/right/image"]) == ("/right/image", "/left/image")
    for rule, message in (
        ("/left/image=/a", "is no rule like /old:=/new"),
        (":=/a", "is no rule"),
        ("/fused:=/a", "/fused is not played; played are /left/image"),
        ("/left/image:=/right/image", "/left/image and /right/image would both be played as /right/image"),
    ):
        with pytest.raises(CommandError, match=message):
            remap(channels, [rule])


def test_moments() -> None:
    """Seconds from the beginning, Unix time, ISO 8601; all exact in ns."""
    first = 1_700_000_000 * S + 123
    for text, expected in (
        ("0", first),
        ("12.000000001", first + 12 * S + 1),
        (" -1.5", first - 3 * S // 2),
        ("1e1", first + 10 * S),
        ("@1700000000.123456789", 1_700_000_000_123_456_789),
        ("2023-11-14T22:13:20Z", 1_700_000_000 * S),
        ("2023-11-14T22:13:20.000001", 1_700_000_000 * S + 1000),
        ("2023-11-15T00:13:20+02:00", 1_700_000_000 * S),
    ):
        assert parse_moment(text, first) == expected
    for text in ("", "soon", "nan", "inf", "@", "1e999999999", "1:30"):
        with pytest.raises(ValueError, match="is no time"):
            parse_moment(text, first)
