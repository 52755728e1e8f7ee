"""The folders keep the shape that makes the namespace package work."""

from pathlib import Path

ROOT = Path(__file__).parent.parent


def test_no_portion_claims_the_namespace():
    stray = [str(p) for p in ROOT.glob("*/fuselog/__init__.py")]
    assert not stray, "an __init__.py here hides the other three portions in an editable install"
