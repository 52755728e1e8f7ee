"""The documentation is true where a machine can tell: configurations, keys, defaults, commands, code, paths, links."""

import re
import shlex
from pathlib import Path

import pytest
import typer
from pydantic_core import PydanticUndefined
from ruamel.yaml import YAML

from fuselog.fusion import compile_plan, parse_config
from fuselog.fusion.config import settings
from fuselog.fusion.kernel.cache import model_card
from fuselog.fusion.kernel.declared import MODEL_NAMES, find_model
from fuselog.service.cli import make_app
from fuselog.service.live.standby import Standby
from fuselog.service.rest.app import create_app
from fuselog.service.rest.http import Entrance

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted([*DOCS.glob("*.md"), ROOT / "docker" / "README.md"])
DEMO = (ROOT / "docker" / "demo.yaml").read_text()
COMMAND = typer.main.get_command(make_app())

_SECTIONS = {  # first cell of a table's head, or the heading above it: whose keys it lists
    "Top level": settings.Config,
    "model": settings.ModelSettings,
    "initial": settings.InitialSettings,
    "gain": settings.GainSettings,
    "cycle": settings.CycleSettings,
    "reacquire": settings.ReacquireSettings,
    "schedule": settings.VariantSettings,
    "when": settings.WhenSettings,
    "lag": settings.LagSettings,
    "One sensor": settings.SensorSettings,
    "adapt of the model": settings.ProcessAdaptSettings,
    "robust": settings.RobustSettings,
    "adapt": settings.AdaptSettings,
    "gate_recovery": settings.GateRecoverySettings,
    "stationary": settings.StationarySettings,
    "mount": settings.MountSettings,
    "states": settings.StatesSettings,
    "field": settings.FieldSettings,
    "output": settings.OutputSettings,
    "smooth": settings.SmoothSettings,
    "zenoh": settings.ZenohSettings,
    "tls": settings.TlsSettings,
    "http": settings.HttpSettings,
    "tls of http": settings.HttpTlsSettings,
    "record": settings.RecordSettings,
    "fleet": settings.FleetSettings,
    "checkpoint": settings.CheckpointSettings,
}


def blocks(language):
    """All code blocks of a language, as (page and number, text)."""
    found = []
    for page in PAGES:
        texts = re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)
        found += [pytest.param(text, id=f"{page.name}-{n}") for n, text in enumerate(texts)]
    return found


def tables(text):
    """Tables with the columns default and meaning: {section: {key: default as written}}."""
    found, heading, section = {}, "", None
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        if line.startswith("#"):
            heading = line.lstrip("# ")
        if not line.startswith("|"):
            section = None
        elif cells[1:] == ["default", "meaning"]:
            section = found.setdefault(heading if cells[0] == "key" else cells[0], {})
        elif section is not None and not line.startswith("|---"):
            section[cells[0].strip("|` ")] = cells[1].strip("`")
    return found


@pytest.mark.parametrize("text", blocks("yaml"))
def test_configurations_compile(text):
    """A whole configuration by itself; a part of one in the place of the same part of docker/demo.yaml."""
    config = YAML(typ="safe").load(DEMO)
    part = YAML(typ="safe").load(text)
    if "fuselog" in part:
        compile_plan(*parse_config(text))
        return
    lines = [text]
    for key in config.keys() - part.keys():
        lines += re.findall(rf"^{key}:.*\n(?:[ #].*\n|\n)*", DEMO, re.MULTILINE)
    compile_plan(*parse_config("".join(lines)))


@pytest.mark.parametrize("section", _SECTIONS)
def test_every_key_is_listed_with_its_default(section):
    kind = _SECTIONS[section]
    listed = tables((DOCS / "configuration.md").read_text())[section]
    fields = {field.alias or name: field for name, field in kind.model_fields.items()}
    assert list(listed) == list(fields)
    for key, field in fields.items():
        if field.is_required():
            assert listed[key] == "required", key
            continue
        default = field.get_default(call_default_factory=True)
        assert default is not PydanticUndefined
        written = YAML(typ="safe").load(listed[key])
        if isinstance(default, settings.Settings):
            assert written == {}, key
        else:
            assert written == (list(default) if isinstance(default, tuple) else default), key


@pytest.mark.parametrize("name", MODEL_NAMES)
def test_models_are_described_as_they_are(name):
    text = (DOCS / "models.md").read_text()
    card = model_card(find_model(name))
    row = next(line for line in text.splitlines() if line.startswith(f"| `{name}`"))
    assert re.sub(r"\([a-z]+\)", "", row.split("|")[3]).split() == list(card.states)
    assert row.split("|")[4].split() == list(card.inputs)
    section = text.partition(f"## {name}\n")[2].partition("\n## ")[0]
    listed = {key: float(value) for key, value in re.findall(r"\| `(\w+)` \| ([0-9.e-]+)", section)}
    assert listed == card.noise


def commands():
    """Every line of a shell block that calls fuselog."""
    found = []
    for block in blocks("sh"):
        lines = block.values[0].replace("\\\n", " ").splitlines()
        found += [pytest.param(s, id=s.partition("#")[0].strip()) for s in lines if s.startswith("fuselog ")]
    return found


@pytest.mark.parametrize("line", commands())
def test_commands_exist_with_their_options(line):
    _, name, *arguments = shlex.split(line, comments=True)
    command = COMMAND.commands[name]
    while hasattr(command, "commands"):
        name, *arguments = arguments
        command = command.commands[name]
    command.make_context(name, arguments)


@pytest.mark.parametrize("page", [p for p in PAGES if "```python" in p.read_text()], ids=lambda p: p.name)
def test_python_runs(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fusion.yaml").write_text(DEMO)
    names = {}
    for text in re.findall(r"^```python\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL):
        exec(compile(text, str(page), "exec"), names)
    if page.name == "models.md":
        from fuselog.fusion.kernel.codegen import generate

        assert "N = 3  # x y yaw" in generate(names["tricycle"](), {})


def test_every_path_of_the_interface_is_documented():
    config, source = parse_config("{fuselog: 1, model: {name: unicycle}, sensors: {any: {topic: any, fuse: [v]}}}")
    served = Standby(Entrance(config.http, source, behind_proxy=False))
    app = create_app(served, alive=lambda: True, ready=lambda: True)
    text = (DOCS / "http.md").read_text()
    for path, operations in app.openapi()["paths"].items():
        for method in operations:
            assert re.search(rf"`{method.upper()} {re.escape(path)}[`?]", text), (method, path)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text()):
        assert target.startswith("https://") or (page.parent / target).exists(), target


def test_the_index_has_every_page():
    index = (DOCS / "README.md").read_text()
    assert {page.name for page in DOCS.glob("*.md")} - {"README.md"} <= set(re.findall(r"\]\(([^)]+)\)", index))
