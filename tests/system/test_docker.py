"""The container files refer to what exists: in the project, on the command line, and among each other."""

import json
import re
import tomllib
from pathlib import Path

import pytest
import typer
from ruamel.yaml import YAML

from fuselog.fusion import compile_plan, load_config
from fuselog.service.cli import make_app

ROOT = Path(__file__).parents[2]
DOCKER = ROOT / "docker"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
COMMAND = typer.main.get_command(make_app())


def instructions():
    """The Dockerfile as (instruction, rest), comments gone and continued lines joined."""
    text = re.sub(r"^\s*#.*\n", "", (DOCKER / "Dockerfile").read_text(), flags=re.MULTILINE)
    lines = re.sub(r"\\\n\s*", "", text).splitlines()
    return [tuple(line.split(maxsplit=1)) for line in lines if line]


def copied():
    """What the Dockerfile takes from the project, without what one stage takes from another."""
    rests = [rest.split() for name, rest in instructions() if name == "COPY" and not rest.startswith("--from")]
    return {source for *sources, _ in rests for source in sources}


def values(instruction):
    return [rest for name, rest in instructions() if name == instruction]


def parse(arguments):
    """Raises when the command line does not know the command or an option."""
    name, *rest = arguments
    COMMAND.commands[name].make_context(name, list(rest))


@pytest.fixture(scope="module")
def compose():
    return YAML(typ="safe").load((DOCKER / "compose.yaml").read_text())


def test_the_image_is_built_from_all_that_the_wheel_needs():
    wheel = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
    needed = {package.partition("/")[0] for package in wheel}
    needed |= {"pyproject.toml", PROJECT["project"]["readme"], *PROJECT["project"]["license-files"]}
    own = {"examples", "docker/demo.yaml", "docker/probe.py"}
    assert copied() == needed | own
    assert all((ROOT / path).exists() for path in own)


def test_all_that_is_copied_passes_the_ignore_file():
    lines = (ROOT / ".dockerignore").read_text().splitlines()
    assert {line[1:] for line in lines if line.startswith("!")} == copied()


def test_both_stages_stand_on_the_same_base():
    froms = [rest.split()[0] for rest in values("FROM")]
    assert froms == ["${BASE}", "${BASE}"]


def test_the_container_is_no_ones_root_and_ends_when_asked():
    assert values("USER") == ["10001:10001"]
    assert values("STOPSIGNAL") == ["SIGTERM"]
    assert json.loads(values("ENTRYPOINT")[0]) == list(PROJECT["project"]["scripts"])


def test_commands_in_the_dockerfile_exist():
    parse(json.loads(values("CMD")[0]))
    for run in values("RUN"):
        for command in re.findall(r"\bfuselog ((?:warm-up|simulate|reprocess)\b[^&]*)", run):
            parse(command.split())


def test_the_version_label_is_the_projects():
    assert f"VERSION={PROJECT['project']['version']}" in values("ARG")


def test_the_demo_configuration_compiles_and_meets_the_router(compose):
    plan = compile_plan(*load_config(DOCKER / "demo.yaml"))
    assert plan.config.zenoh.mode == "client"
    assert plan.config.zenoh.connect == ["tcp/router:7447"]
    assert "router" in compose["services"]
    assert f"127.0.0.1:8080:{plan.config.http.port}" in compose["services"]["serve"]["ports"]


def test_services_are_hardened_and_reached_from_this_machine_only(compose):
    for name, service in compose["services"].items():
        assert service["read_only"] is True, name
        assert service["cap_drop"] == ["ALL"], name
        assert service["security_opt"] == ["no-new-privileges:true"], name
        assert all(port.startswith("127.0.0.1:") for port in service.get("ports", [])), name


def test_compose_refers_to_what_exists(compose):
    for name, service in compose["services"].items():
        assert ("build" in service) or re.search(r":\d+\.\d+\.\d+$", service["image"]), f"{name}: a pinned image"
        assert set(service.get("depends_on", [])) <= set(compose["services"])
        for volume in service.get("volumes", []):
            source = volume.partition(":")[0]
            assert source in compose["volumes"] or (DOCKER / source).is_file(), volume
        if "build" in service:
            assert (DOCKER / service["build"]["context"]).resolve() == ROOT
            assert (ROOT / service["build"]["dockerfile"]).is_file()
            if "command" in service:
                parse(service["command"])
