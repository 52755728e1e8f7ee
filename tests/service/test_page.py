"""The files of the status page as they are served: complete, closed to the outside, kept while they are right."""

import re

import httpx
import pytest
from fastapi import FastAPI

from fuselog.service.page.page import add_page, assets

from .test_api import Client


@pytest.fixture(scope="module")
def client() -> Client:
    """An application that has nothing but the page."""
    app = FastAPI()
    add_page(app)
    assert app.openapi()["paths"] == {}
    return Client(app)


def test_everything_it_refers_to_is_in_the_package(client: Client) -> None:
    """From the page through styles and modules: each is there with its type, and all that is there is used."""
    types = {"css": "text/css; charset=utf-8", "js": "text/javascript; charset=utf-8", "svg": "image/svg+xml"}
    index = client.get("/")
    assert index.headers["content-type"] == "text/html; charset=utf-8"
    wanted = re.findall(r'(?:href|src)="(page/[^"]+)"', index.text)
    found: dict[str, httpx.Response] = {}
    while wanted:
        path = wanted.pop()
        if path in found:
            continue
        found[path] = client.get(f"/{path}")
        assert found[path].status_code == 200
        assert found[path].headers["content-type"] == types[path.rpartition(".")[2]]
        wanted += [f"page/{name}" for name in re.findall(r'from "\./([^"]+)"', found[path].text)]
    assert {path.removeprefix("page/") for path in found} | {"index.html"} == set(assets())


def test_nothing_comes_from_elsewhere(client: Client) -> None:
    """The policy, and files without a style or script that it would forbid."""
    for name, content in assets().items():
        answer = client.get("/" if name == "index.html" else f"/page/{name}")
        assert answer.headers["content-security-policy"].startswith("default-src 'self';")
        assert "unsafe" not in answer.headers["content-security-policy"]
        assert answer.headers["x-content-type-options"] == "nosniff"
        addresses = re.findall(r"https?://[^\s\"'`]+", content.decode())
        assert set(addresses) <= {"http://www.w3.org/2000/svg"}
    index = assets()["index.html"].decode()
    assert not re.search(r"\sstyle=|\son\w+=|<style|<script(?![^>]*src)", index)


def test_kept_copies_are_asked_for_again(client: Client) -> None:
    """304 without a body for what has not changed, also among several, and to a proxy that weakened the tag."""
    answer = client.get("/page/page.css")
    assert answer.headers["cache-control"] == "no-cache"
    tag = answer.headers["etag"]
    for told in (tag, f'"other", W/{tag}'):
        again = client.get("/page/page.css", headers={"If-None-Match": told})
        assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", tag)
    assert client.get("/page/page.css", headers={"If-None-Match": '"other"'}).status_code == 200
    head = client.request("HEAD", "/")
    assert (head.status_code, head.content) == (200, b"")


def test_only_files_of_the_page(client: Client) -> None:
    """No other file of the package, nor of the machine."""
    for path in ("/page/page.py", "/page/__init__.py", "/page/", "/page/..%2Fpage.py", "/page/%2e%2e/rest/api.py"):
        assert client.get(path).status_code == 404
    assert client.request("POST", "/").status_code == 405
