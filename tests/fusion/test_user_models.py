"""Models from a user's file: they work like fuselog's own, and mistakes are shown at their line."""

from pathlib import Path

import numpy as np
import pytest
from tests.fusion.setups import Sample, events_of

from fuselog.fusion import Engine, Plan, load_plan
from fuselog.schemas import ConfigError

TRICYCLE = """\
import sympy as sp
from fuselog.fusion.models import DT, Model, symbol, symbols, white_noise

def tricycle():
    x, y, yaw, v, steering = symbols("x y yaw v steering")
    return Model(
        name="tricycle",
        states={"x": "m", "y": "m", "yaw": "rad"},
        inputs={"v": "m/s", "steering": "rad"},
        parameters={"wheelbase": 1.2},
        transition={
            "x": x + v * sp.cos(steering) * sp.cos(yaw) * DT,
            "y": y + v * sp.cos(steering) * sp.sin(yaw) * DT,
            "yaw": yaw + v * sp.sin(steering) / symbol("wheelbase") * DT,
        },
        noise={"x": 1e-4, "y": 1e-4, "yaw": 1e-4},
        covariance=white_noise("x", "y", "yaw"),
    )
"""
CONFIG = """\
fuselog: 1
model: {model}
initial: {{state: {{x: 0, y: 0, yaw: 0.5}}, sd: {{x: 0.1, y: 0.1, yaw: 0.1}}}}
sensors:
  drive: {{topic: /drive, kind: input, fields: {{v: v, steering: s}}, noise: {{v: 0.1, steering: 0.1}}}}
  gps: {{topic: /gps, fuse: [x, y]}}
"""


def plan_of(folder: Path, text: str = TRICYCLE, model: str = "robot.py:tricycle") -> Plan:
    (folder / "robot.py").write_text(text)
    (folder / "fusion.yaml").write_text(CONFIG.format(model=model))
    return load_plan(folder / "fusion.yaml")


def refused(folder: Path, text: str, model: str = "robot.py:tricycle") -> str:
    with pytest.raises(ConfigError) as caught:
        plan_of(folder, text, model)
    return str(caught.value)


@pytest.mark.parametrize(
    ("model", "wheelbase"), [("robot.py:tricycle", 1.2), ("{name: robot.py:tricycle, parameters: {wheelbase: 2}}", 2.0)]
)
def test_a_model_beside_the_configuration(tmp_path: Path, model: str, wheelbase: float) -> None:
    plan = plan_of(tmp_path, model=model)
    assert plan.states == ("x", "y", "yaw")
    samples = [
        Sample(10**9, "drive", [2.0, 0.3], 0.01 * np.eye(2)),
        Sample(10**9 + 5 * 10**8, "drive", [2.0, 0.3], 0.01),
    ]
    engine = Engine(plan)
    engine.advance(events_of(plan, samples))
    expected = [np.cos(0.3) * np.cos(0.5), np.cos(0.3) * np.sin(0.5), 0.5 + np.sin(0.3) / wheelbase]
    assert engine.estimate.x == pytest.approx(expected, abs=1e-14)
    F = np.array([[1, 0, -expected[1]], [0, 1, expected[0]], [0, 0, 1]])
    B = np.array(
        [
            [np.cos(0.3) * np.cos(0.5), -2 * np.sin(0.3) * np.cos(0.5)],
            [np.cos(0.3) * np.sin(0.5), -2 * np.sin(0.3) * np.sin(0.5)],
            [np.sin(0.3) / wheelbase, 2 * np.cos(0.3) / wheelbase],
        ]
    )
    P = F @ (0.01 * np.eye(3)) @ F.T + 0.01 * B @ B.T * 0.5 + 1e-4 * 0.5 * np.eye(3)
    assert pytest.approx(P, abs=1e-15) == engine.estimate.P


def test_a_changed_file_is_another_model(tmp_path: Path) -> None:
    assert plan_of(tmp_path).card.noise["x"] == 1e-4
    assert plan_of(tmp_path, TRICYCLE.replace('noise={"x": 1e-4', 'noise={"x": 1e-3')).card.noise["x"] == 1e-3


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("sp.cos(steering) * sp.cos(yaw)", "sp.cos(steerign) * sp.cos(yaw)", "robot.py:12: NameError: name 'steerign'"),
        ('symbol("wheelbase")', 'symbol("wheelbsae")', "robot.py:14: yaw: uses wheelbsae, which is no state"),
        ("sp.cos(steering) * sp.sin(yaw)", "sp.floor(yaw)", "robot.py:13: y: uses floor; there are sin, cos"),
        ('            "y": y + v', '            "z": y + v', "robot.py:8: y: is a state without a transition"),
        ('"y", "yaw"),\n    )', '"y", "yam"),\n    )', "robot.py:17: yam: has process noise but is no state"),
        ('"yaw": yaw + v', '"yaw": sp.Matrix([yaw]) + 0 * v', "robot.py:14: "),
        ("def tricycle():", "def tricycle(:", "robot.py:4: SyntaxError"),
        ("    return Model(", "    return dict(", "robot.py: tricycle returns dict, not a Model"),
        ("def tricycle", "def bicycle", "robot.py: has no function tricycle"),
    ],
)
def test_mistakes_are_shown_at_their_line(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert old in TRICYCLE
    message = refused(tmp_path, TRICYCLE.replace(old, new))
    assert message.startswith(f"{tmp_path}/fusion.yaml:2:1: model.name: "), message
    assert expected in message, message


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    assert f"{tmp_path}/boat.py: no such file" in refused(tmp_path, TRICYCLE, "boat.py:tricycle")
