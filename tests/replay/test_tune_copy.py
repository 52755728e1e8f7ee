"""The copy of a configuration: another gain section, and every other line and comment as it was."""

from pathlib import Path

import pytest

from fuselog.fusion import parse_config
from fuselog.replay.tune.copy import text_with_gain

ROOT = Path(__file__).parents[2]
CONFIGS = [
    *sorted((ROOT / "examples").glob("*.yaml")),
    *sorted((ROOT / "service/fuselog/service/demo_configs").glob("*.yaml")),
    ROOT / "docker/demo.yaml",
]
GAIN = {
    "mode": "fixed",
    "form": "matrix",
    "weights": {"x": {"a.x": 0.328984, "b.x": 1e-05}, "y": {"a.y": -0.5}},
    "rates": {"a": 10.0, "b": 12.5},
    "nominal": {"x": -1.5},
}
HAND_MADE = """\
# Three sensors.
fuselog: 1
model:
    name: "brownian"       # quoted, and indented by four

gain:
    # Bezmen's article, eq. 29
    mode: fixed            # by hand
    form: state
    sum: one
    weights:
        x:
            a.x: 0.5       # the good one
            # and the other one
            b.x: 0.5
    # the end of the gain

# The sensors, best first.
sensors:
    a: {topic: /a,   fuse: [x], noise: {x: 0.1}}   # spaces   stay
    b: {topic: '/b', fuse: [x], noise: {x: 1e-1}}
"""


def rewritten(text: str) -> str:
    return text_with_gain(parse_config(text)[1], GAIN)


def comments(text: str) -> list[str]:
    return sorted(line.partition("#")[2].strip() for line in text.splitlines() if "#" in line)


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.name)
def test_every_line_stays_but_those_of_the_gain(path: Path) -> None:
    text = path.read_text()
    new = rewritten(text)
    config, _ = parse_config(new)
    assert config.gain.model_dump(include=set(GAIN)) == GAIN
    old = parse_config(text)[0]
    assert config.model_copy(update={"gain": old.gain}) == old
    assert comments(new) == comments(text)
    begin = new.index("gain:\n")
    head, tail = new[:begin], new[new.index("\n", new.index("  nominal: ")) + 1 :]
    assert text.startswith(head)
    assert text.endswith(tail)


def test_comments_of_what_is_replaced_stay_in_the_section() -> None:
    new = rewritten(HAND_MADE)
    assert comments(new) == comments(HAND_MADE)
    before, section, after = HAND_MADE.partition("gain:\n")
    end = HAND_MADE[HAND_MADE.index("\n# The sensors") :]
    assert section
    assert after
    assert new.startswith(before)
    assert new.endswith(end)
    changed = new.removeprefix(before).removesuffix(end)
    assert "    mode: fixed            # by hand\n" in changed
    assert "the good one" in changed
    assert "    form: matrix\n" in changed
    assert "sum:" not in changed
    assert parse_config(new)[0].gain.weights == GAIN["weights"]


def test_a_section_at_the_end_of_a_file_without_a_last_newline() -> None:
    text = "fuselog: 1\nmodel: brownian\nsensors:\n  a: {topic: /a, fuse: [x]}\ngain: {mode: optimal}"
    new = rewritten(text)
    assert new.startswith("fuselog: 1\nmodel: brownian\nsensors:\n  a: {topic: /a, fuse: [x]}\ngain:\n  mode: fixed\n")
    assert parse_config(new)[0].gain.weights == GAIN["weights"]


def test_a_new_section_stands_before_the_sensors_and_what_is_said_of_them() -> None:
    text = "fuselog: 1\nmodel: brownian\n\n# all of them\nsensors:\n  a: {topic: /a, fuse: [x]}\n"
    new = rewritten(text)
    assert new.startswith("fuselog: 1\nmodel: brownian\ngain:\n  mode: fixed\n")
    assert new.endswith("\n\n# all of them\nsensors:\n  a: {topic: /a, fuse: [x]}\n")


def test_a_comment_stays_with_its_key() -> None:
    """A comment stays with its key; weights in braces stay so."""
    head, sensors = "fuselog: 1\nmodel: brownian\n", "sensors: {a: {topic: /a, fuse: [x]}}\n"
    new = rewritten(f"{head}gain:\n  mode: fixed\n  weights: {{a.x: 1}} # all of it\n{sensors}")
    assert "  weights: {x: {a.x: 0.328984, b.x: 1e-05}, y: {a.y: -0.5}} # all of it\n" in new


def test_json_is_written_anew() -> None:
    text = '{"fuselog": 1, "model": {"name": "brownian"}, "sensors": {"a": {"topic": "/a", "fuse": ["x"]}}}'
    config, _ = parse_config(rewritten(text))
    assert config.gain.weights == GAIN["weights"]
    assert config.sensors["a"].topic == "/a"
