"""The status page in a real Chromium, over what real filters said of real messages."""

import json
import os
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from urllib.request import urlopen

import numpy as np
import pytest

from fuselog.fusion.gate import chi_square_quantile
from fuselog.fusion.health import Losses

from . import chromium
from .chromium import Browser, Page
from .conftest import UNICYCLE
from .status_service import Frames, StatusService, frames_of, with_losses

Serve = Callable[..., StatusService]
Open = Callable[..., Page]

SURE = UNICYCLE.replace("noise: {x: 0.1, y: 0.1}", "noise: {x: 0.02, y: 0.02}")
LINE = """\
fuselog: 1
model: {name: constant_velocity_1d}
sensors:
  camera: {topic: /camera/pose, fuse: [x], noise: {x: 0.1}}
"""
SILENT = "camera: silent for"  # what health says of a sensor from which nothing comes


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """A Chromium for all tests here."""
    if chromium.PROGRAM is None:
        pytest.skip("there is no chromium")
    browser = Browser(tmp_path_factory.mktemp("chromium"))
    yield browser
    browser.close()


@pytest.fixture
def open_page(browser: Browser) -> Iterator[Open]:
    """Open pages; none of them may have said anything on its console, or asked any other host."""
    pages: list[tuple[str, Page]] = []

    def open(url: str, **options: Any) -> Page:
        page = browser.open(url, **options)
        pages.append((url, page))
        return page

    yield open
    for url, page in pages:
        page.evaluate("1")  # takes the events that are there
        assert not page.problems
        asked = [urlsplit(request["url"]) for request in page.requests]
        assert {one.netloc for one in asked if one.scheme != "data"} == {urlsplit(url).netloc}


@pytest.fixture
def serve() -> Iterator[Serve]:
    """Start services."""
    with ExitStack() as stack:
        yield lambda *args, **options: stack.enter_context(StatusService(*args, **options))


@pytest.fixture(scope="module")
def frames(small_log: Path) -> dict[str, Frames]:
    """Filters that fare differently: well, with a silent sensor, too sure of one, of another model, at rest."""
    well = frames_of(UNICYCLE, small_log)
    return {
        "well": well,
        "blind": frames_of(UNICYCLE, small_log, blind=("/camera/pose", 8.0)),
        "sure": frames_of(SURE, small_log),
        "line": frames_of(LINE, small_log),
        "rest": well[:1],
    }


def ask(service: StatusService, path: str) -> Any:
    """What the service answers."""
    with urlopen(f"{service.url}/api/v1/filters{path}", timeout=10) as answer:
        return json.load(answer)


def statuses(service: StatusService) -> dict[str, str]:
    """What the service says of every filter."""
    return {id: one["status"] for id, one in zip(service.filters, ask(service, "")["filters"], strict=True)}


def at_end(page: Page, service: StatusService) -> None:
    """Wait until the page shows every filter as the service says that it is now."""
    shows(page, statuses(service))


def shows(page: Page, status: dict[str, str]) -> None:
    """Wait until the list has these filters with their statuses, and no others."""
    wanted = sorted(map(list, status.items()))
    rows = "[...document.querySelectorAll('#list li')]"
    shown = f"{rows}.map(e => [e.dataset.id, e.querySelector('.word').innerText]).sort()"
    page.wait(f"JSON.stringify({shown}) === JSON.stringify({json.dumps(wanted)})")


def choose(page: Page, service: StatusService, id: str) -> None:
    """Choose a filter with the mouse, and wait until its newest estimate is shown."""
    page.click(f"#list [data-id='{id}']")
    page.wait(f"document.querySelector('#name').innerText === {json.dumps(id)}")
    newest = datetime.fromtimestamp(ask(service, f"/{id}/health")["t_ns"] / 1e9, UTC).isoformat(" ", "milliseconds")
    page.wait(f"document.querySelector('#figures').innerText.includes('{newest.removesuffix('+00:00')} UTC')")


def test_filters_at_a_glance(serve: Serve, open_page: Open, frames: dict[str, Frames]) -> None:
    """A row for each filter with its status and first reason, the worst first; words and buttons find some."""
    service = serve(frames)
    page = open_page(service.url)
    at_end(page, service)
    health = {id: ask(service, f"/{id}/health") for id in frames}
    assert health["blind"]["status"] == "degraded"
    rows = page.texts("#list li .id")
    assert sorted(rows) == sorted(frames)
    assert health[rows[0]]["status"] == "degraded"
    assert health[rows[-1]]["status"] in ("ok", "healthy")
    assert page.evaluate("document.querySelector('#list li use').getAttribute('href')") == "#shape-degraded"
    assert SILENT in page.text("#list [data-id=blind] .why")
    page.evaluate("document.querySelector('#search').focus()")
    page.type("unicycle silent")
    assert page.texts("#list li .id") == ["blind"]
    page.evaluate("document.querySelector('#search').value = ''")
    page.click("#counts button")  # of the worst status
    assert page.texts("#list li .word") == ["degraded"] * sum(one["status"] == "degraded" for one in health.values())
    assert page.evaluate("document.querySelector('#counts button').getAttribute('aria-pressed')") == "true"


def test_a_running_service(open_page: Open) -> None:
    """The same of ``fuselog serve`` somewhere else, whose data must not change meanwhile."""
    url = os.environ.get("FUSELOG_STATUS_PAGE")
    if url is None:
        pytest.skip("FUSELOG_STATUS_PAGE names no service")
    with urlopen(f"{url}/api/v1/filters", timeout=10) as answer:
        filters = json.load(answer)["filters"]
    page = open_page(url)
    shows(page, {one["id"]: one["status"] for one in filters if not one.get("ended")})
    assert page.text("#connection") == "live"
    chosen = next(one for one in filters if one["id"] == page.text("#name"))
    assert page.texts("#sensors .name") == chosen["sensors"]
    assert page.texts("#states tbody th") == chosen["states"]


def test_a_filter_and_its_sensors(serve: Serve, open_page: Open, frames: dict[str, Frames]) -> None:
    """Status, reasons, ledger and NIS of each sensor as the service says."""
    service = serve(frames)
    page = open_page(service.url)
    at_end(page, service)
    choose(page, service, "sure")
    health = ask(service, "/sure/health")
    assert page.texts("#reasons li") == health["reasons"]
    for number, (name, sensor) in enumerate(health["sensors"].items(), start=1):
        row = page.text(f"#sensors tbody:nth-of-type({number})")
        assert row.startswith(f"{name}\n")
        assert sensor["topic"] in row
        assert re.search(rf"\b{sensor['status']}\b", row)
        assert all(reason in row for reason in sensor["reasons"])
        assert f"{sensor['nis']['mean']:.3g}"[:4] in row
    table = "[...document.querySelectorAll('#ledger tbody tr')].map(row => [...row.cells].map(cell => cell.innerText))"
    cells = page.evaluate(table)
    accounts = {row[0]: [int(cell.replace("\u202f", "")) for cell in row[1:4]] for row in cells}
    expected = {
        name: [s["account"][key] for key in ("received", "fused", "gated")] for name, s in health["sensors"].items()
    }
    plain = {name: numbers for name, numbers in accounts.items() if name != "all"}
    assert plain == expected
    assert accounts["all"] == [sum(column) for column in zip(*expected.values(), strict=True)]
    assert {row[-1] for row in cells} == {"exact"}


def test_changes_are_logged_and_said(serve: Serve, open_page: Open, frames: dict[str, Frames]) -> None:
    """A sensor falls silent: one line, with time and reason, and words for those who cannot see it."""
    service = serve({"blind": frames["blind"], "well": frames["well"]})
    page = open_page(service.url)
    page.evaluate(
        "window.said = []; new MutationObserver(() => said.push(document.querySelector('#announce').innerText))"
        ".observe(document.querySelector('#announce'), {childList: true, characterData: true, subtree: true})"
    )
    at_end(page, service)
    lines = [line for line in page.texts("#changes li") if SILENT in line]
    assert len(lines) == 1
    assert "blind" in lines[0]
    assert "2023-11-14 22:13:" in lines[0]  # the time of the data
    assert "degraded" in lines[0]
    assert any(f"blind is degraded: {SILENT}" in said for said in page.evaluate("window.said"))


def test_what_nobody_examined_is_a_dash(serve: Serve, open_page: Open, frames: dict[str, Frames]) -> None:
    """A filter without a sample, and figures that this service does not have."""
    service = serve({"rest": frames["rest"]})
    page = open_page(service.url)
    at_end(page, service)
    page.wait("document.querySelector('#sensors tbody')")
    row = page.text("#sensors tbody")
    assert row.count("–") == 10  # rate, age, delay, NIS, with what they go by, and three shares
    assert page.evaluate("getComputedStyle(document.querySelector('#map-figure')).display") == "none"
    page.click("#all summary")
    page.wait("document.querySelector('#all dd')")
    assert not re.search(r"NaN|undefined|null|Infinity", page.text("body"))


@pytest.mark.parametrize(
    ("nis", "words", "inside"),
    [
        ({"mean": 1.1, "dof": 1.0, "band": [0.8, 1.2]}, "1.10 / 1.00, inside 0.800 to 1.20", "true"),
        ({"mean": 1.5, "dof": 1.0, "band": [0.8, 1.2]}, "1.50 / 1.00, outside 0.800 to 1.20", "false"),
        ({"mean": 50.0, "dof": 2.0, "band": [1.5, 2.6]}, "50.0 / 2.00, outside 1.50 to 2.60", "false"),
        ({"mean": 1.5, "dof": 1.0}, "1.50 / 1.00", None),
        ({"mean": None, "dof": 1.0, "band": [None, 1.2]}, "–not examined: too few / 1.00", None),
    ],
)
def test_nis_and_its_band(serve: Serve, open_page: Open, nis: dict[str, Any], words: str, inside: str | None) -> None:
    """Mark and band in the picture are where the words say, on a scale with the expected value at a third."""
    page = open_page(serve({}).url)
    sensors = {
        "gps": {"status": "ok", "nis": nis, "rate": {"hz": 9.5}, "not_examined": {"nis": "too few"}, "new": {"a": [1]}}
    }
    page.evaluate(
        "import('/page/sensors.js').then(m => { document.querySelector('#chosen').hidden = false;"
        f" m.showSensors(document.querySelector('#sensors'), {json.dumps(sensors)}) }})"
    )
    assert page.evaluate("document.querySelector('#sensors span.nis').textContent") == words
    assert page.evaluate("document.querySelector('#sensors .second').parentNode.textContent") == "9.50 / –not examined"
    picture = "document.querySelector('#sensors .{}')"
    assert page.evaluate(f"{picture.format('mark')}.getAttribute('data-inside')") == inside
    if nis["mean"] is None:
        assert page.evaluate(f"getComputedStyle({picture.format('mark')}).visibility") == "hidden"
        return
    box = page.evaluate(f"(b => [b.x, b.width])({picture.format('mark')}.getBBox())")
    assert abs(box[0] + box[1] / 2 - min(35 * nis["mean"] / nis["dof"], 100.5)) < 0.1
    if "band" in nis:
        band = page.evaluate(f"(b => [b.x, b.x + b.width])({picture.format('band')}.getBBox())")
        np.testing.assert_allclose(band, [35 * end / nis["dof"] for end in nis["band"]])


def test_map_and_states(serve: Serve, open_page: Open, frames: dict[str, Frames]) -> None:
    """The trail ends at the estimate; a model without a plane has sparklines alone."""
    service = serve(frames)
    page = open_page(service.url)
    at_end(page, service)
    choose(page, service, "well")
    x, y, _ = ask(service, "/well/state")["position"]
    shown = re.findall(r"\b[xy] (\S+) m", page.text("#map-words").replace("−", "-"))
    np.testing.assert_allclose([float(text) for text in shown], [x, y], rtol=1e-3)
    here = page.evaluate(
        "[...document.querySelectorAll('#map .here')].map(c => [c.cx.baseVal.value, c.cy.baseVal.value])[0]"
    )
    trail = page.evaluate("[...document.querySelector('#map .trail').points].map(p => [p.x, p.y])")
    assert len(trail) > 20
    assert trail[-1] == here
    true = np.array([frame.estimate.x[:2] for frame in frames["well"][1:]])
    drawn = np.array(trail[-len(true) :]) * [1, -1]
    scale = np.ptp(drawn[:, 0]) / np.ptp(true[-len(drawn) :, 0])
    np.testing.assert_allclose(np.ptp(drawn[:, 1]), scale * np.ptp(true[-len(drawn) :, 1]), rtol=0.01)  # one scale
    bar = page.evaluate("document.querySelector('#map path.scale').getBBox().width")
    words = page.evaluate("document.querySelector('#map text.scale').textContent")
    np.testing.assert_allclose(bar / scale, float(words.removesuffix(" m")), rtol=0.02)
    choose(page, service, "line")
    assert page.evaluate("getComputedStyle(document.querySelector('#map-figure')).display") == "none"
    assert len(page.texts("#states tbody tr")) == 2
    assert page.evaluate("document.querySelector('#states .band').getAttribute('d').length") > 200


def test_ellipse_holds_95_percent(serve: Serve, open_page: Open) -> None:
    """Half axes and direction against numpy's eigenvectors."""
    page = open_page(serve({}).url)
    P = np.array([[4.0, 1.5], [1.5, 1.0]])
    found = page.evaluate(f"import('/page/map.js').then(m => m.ellipseOf({P.tolist()}))")
    variances, axes = np.linalg.eigh(P)
    np.testing.assert_allclose([found["b"], found["a"]], np.sqrt(variances * chi_square_quantile(0.95, 2)), rtol=1e-4)
    np.testing.assert_allclose(abs(axes[:, 1] @ [np.cos(found["angle"]), np.sin(found["angle"])]), 1, rtol=1e-9)


def test_figures_as_people_read_them(serve: Serve, open_page: Open) -> None:
    """Three digits, a unit that suits, and nothing where there is nothing."""
    page = open_page(serve({}).url)
    wanted = {
        "number(0)": "0",
        "number(-0.04567)": "−0.0457",
        "number(123456)": "123456",
        "number(0.00012345)": "1.23e−4",
        "number(1e300)": "1.00e300",
        "number(NaN)": None,
        "number(null)": None,
        "seconds(0.0371)": "37 ms",
        "seconds(9.87)": "9.9 s",
        "seconds(300)": "5 min",
        "seconds(1e5)": "27.8 h",
        "share(0, 10)": "0 %",
        "share(1, 5000)": "< 0.1 %",
        "share(5, 100)": "5.0 %",
        "share(0, 0)": None,
        "count(1234567)": "1\u202f234\u202f567",
        "bytes(1536000)": "1.54 MB",
        "stamp(1700000000123000000)": "2023-11-14 22:13:20.123 UTC",
        "stamp(5000000000)": "5.000 s",
    }
    calls = ", ".join(f"m.{call}" for call in wanted)
    assert page.evaluate(f"import('/page/words.js').then(m => [{calls}])") == list(wanted.values())


def test_events_in_any_pieces(serve: Serve, open_page: Open) -> None:
    """A stream cut after every byte, with both line ends, comments, several lines of data, and other fields."""
    page = open_page(serve({}).url)
    text = ': hello\r\n\r\nevent: health\r\ndata: {"a":\r\ndata: "ü"}\r\nid: 1\r\n\r\ndata:b\n\nevent: lost\ndata: c\n'
    found = page.evaluate(f"""
      import('/page/stream.js').then(async ({{ events }}) => {{
        const bytes = new TextEncoder().encode({json.dumps(text)});
        const start = (c) => {{ for (const b of bytes) c.enqueue(Uint8Array.of(b)); c.close(); }};
        const body = new ReadableStream({{ start }});
        const found = [];
        for await (const event of events(body)) found.push(event);
        return found;
      }})""")
    assert found == [{"type": "health", "data": '{"a":\n"ü"}'}, {"type": "message", "data": "b"}]


def test_token(serve: Serve, open_page: Open, frames: dict[str, Frames]) -> None:
    """Asked for, refused when wrong, sent in a header only, kept for this tab only, and forgotten."""
    service = serve({"well": frames["well"]}, token="right-token")
    page = open_page(service.url)
    page.wait("!document.querySelector('#token').hidden")
    assert page.texts("#list li") == []
    assert page.evaluate("document.activeElement.id") == "token-input"
    page.type("wrong-token")
    page.press("Enter")
    page.wait("document.querySelector('#token-why').innerText.includes('refused the token: no such token')")
    page.type("right-token")
    page.press("Enter")
    page.wait("document.querySelector('#list li')")
    assert page.evaluate("document.querySelector('#token').hidden")
    page.go(service.url)
    page.wait("document.querySelector('#list li')")  # the tab remembers
    assert "right-token" not in page.evaluate("JSON.stringify(localStorage) + document.cookie + location.href")
    assert not any("right-token" in request["url"] for request in page.requests)
    page.click("#forget")
    page.wait("!document.querySelector('#token').hidden")
    assert page.evaluate("sessionStorage.length") == 0
    open_page(service.url).wait("!document.querySelector('#token').hidden")


def test_silence_and_loss_of_the_service_show(serve: Serve, open_page: Open, frames: dict[str, Frames]) -> None:
    """Data that are old are called so; a stream that ended is begun again."""
    service = serve({"well": frames["well"]})
    page = open_page(service.url)
    page.wait("document.querySelector('#connection').innerText === 'live'")
    service.hold.set()
    page.wait("/^stale since [3-9] s$/.test(document.querySelector('#connection').innerText)")
    service.cut.set()
    page.wait(
        "/reconnecting in \\d+ s: the service ended the stream/.test(document.querySelector('#connection').innerText)"
    )
    service.hold.clear()
    service.cut.clear()
    page.wait("document.querySelector('#connection').innerText === 'live'")


def test_keys(serve: Serve, open_page: Open, frames: dict[str, Frames]) -> None:
    """Without a mouse: past the list or through it, and on to the chosen filter."""
    service = serve(frames)
    page = open_page(service.url)
    at_end(page, service)
    page.press("Tab")
    assert page.evaluate("document.activeElement.className") == "skip"
    assert page.evaluate("document.activeElement.getBoundingClientRect().top") >= 0
    ids = page.texts("#list li .id")
    page.evaluate("document.querySelector('#list').focus()")
    page.press("Home")
    page.press("ArrowDown")
    page.press("ArrowDown")
    page.wait(f"document.querySelector('#name').innerText === {json.dumps(ids[2])}")
    active = page.evaluate(
        "document.getElementById(document.querySelector('#list').getAttribute('aria-activedescendant')).dataset.id"
    )
    assert active == ids[2]
    assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    page.press("End")
    page.press("ArrowUp")
    page.wait(f"document.querySelector('#name').innerText === {json.dumps(ids[-2])}")
    page.press("Enter")
    assert page.evaluate("document.activeElement.id") == "detail"
    page.wait(f"location.hash === '#filter={ids[-2]}'")
    page.go(f"{service.url}/#filter={ids[1]}")
    page.wait(f"document.querySelector('#name').innerText === {json.dumps(ids[1])}")


CONTRASTS = """
(() => {
  const canvas = new OffscreenCanvas(1, 1).getContext('2d', { willReadFrequently: true });
  const rgb = (color) => { canvas.clearRect(0, 0, 1, 1); canvas.fillStyle = color; canvas.fillRect(0, 0, 1, 1);
    return [...canvas.getImageData(0, 0, 1, 1).data]; };
  const linear = (v) => v / 255 <= 0.04045 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4;
  const light = ([r, g, b]) => 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
  const behind = (e) => {
    const ground = e ? rgb(getComputedStyle(e).backgroundColor) : [255, 255, 255, 255];
    return ground[3] === 255 ? ground : behind(e.parentElement);
  };
  const found = [];
  for (const e of document.querySelectorAll('body *')) {
    const own = [...e.childNodes].some(n => n.nodeType === 3 && n.data.trim()) || e.matches('.shape');
    if (!own || !e.checkVisibility() || e.closest('.unseen, .skip')) continue;
    const [a, b] = [light(rgb(getComputedStyle(e).color)), light(behind(e))].sort((p, q) => q - p);
    found.push([(a + 0.05) / (b + 0.05), e.tagName + '.' + e.getAttribute('class') + ' ' + e.textContent.slice(0, 40)]);
  }
  return found.sort((p, q) => p[0] - q[0]);
})()"""


@pytest.mark.parametrize("dark", [False, True])
def test_everything_can_be_read(serve: Serve, open_page: Open, frames: dict[str, Frames], dark: bool) -> None:
    """Contrast of at least 4.5 for every text and shape, light and dark (WCAG 2.2, 1.4.3)."""
    service = serve(frames)
    page = open_page(service.url, dark=dark)
    at_end(page, service)
    ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (ground == "rgb(255, 255, 255)") is not dark
    contrasts = page.evaluate(CONTRASTS)
    assert len(contrasts) > 100
    assert contrasts[0][0] >= 4.5, contrasts[0]


def test_theme_is_remembered(serve: Serve, open_page: Open) -> None:
    """System, light, dark: the choice outlives a reload, and the system's does not change it."""
    url = serve({}).url
    page = open_page(url)
    seen = []
    for _ in range(3):
        page.click("#theme")
        seen.append((page.evaluate("document.documentElement.className"), page.text("#theme")))
    assert seen == [("light", "Colours: light"), ("dark", "Colours: dark"), ("", "Colours: system")]
    page.click("#theme")
    page.click("#theme")
    page.go(url)
    page.wait("document.documentElement.className === 'dark'")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(20, 24, 31)"


def test_any_width(serve: Serve, open_page: Open, frames: dict[str, Frames]) -> None:
    """A telephone, a window of 1,280 pixels at 200 %, and wider: nothing sticks out, every figure has its name."""
    service = serve({"a-robot-with-a-name-that-is-as-long-as-names-of-filters-may-be-x": frames["sure"], **frames})
    page = open_page(service.url)
    at_end(page, service)
    age = "document.querySelector('#sensors td[data-label=Age]')"
    for width in (360, 640, 900, 1150, 1280, 1920):
        page.look(width=width)
        page.wait(f"innerWidth === {width}")
        assert page.evaluate("document.documentElement.scrollWidth") <= width, width
        label = page.evaluate(f"getComputedStyle({age}, '::before').content")
        heading = page.evaluate("document.querySelector('#sensors thead').getBoundingClientRect().height")
        assert (label == '"Age"') is not (heading > 10), width


def test_two_hundred_filters(serve: Serve, open_page: Open, frames: dict[str, Frames]) -> None:
    """All are there, in the order of their numbers; what is looked for is found; the choice stays."""
    kinds = [each[-1:] for each in frames.values()]
    service = serve({f"robot-{n}": kinds[n % len(kinds)] for n in range(200)})
    page = open_page(service.url)
    page.wait("document.querySelectorAll('#list li').length === 200")
    choose(page, service, "robot-117")
    at_end(page, service)
    assert page.text("#name") == "robot-117"
    status = statuses(service)
    alike = [id for id in page.texts("#list li .id") if status[id] == status["robot-1"]]
    assert alike == sorted(alike, key=lambda id: int(id.removeprefix("robot-")))
    assert len(alike) >= 40
    page.evaluate("document.querySelector('#search').focus()")
    page.type("robot-117")
    assert page.texts("#list li .id") == ["robot-117"]


def test_texts_of_others_are_texts(serve: Serve, open_page: Open, frames: dict[str, Frames]) -> None:
    """What a publisher says of itself may look like HTML."""
    evil = "<img src=x onerror=alert(1)><script>alert(1)</script>"
    service = serve({"well": with_losses(frames["well"], {"odom": Losses(unknown=3, reason=evil)})})
    page = open_page(service.url)
    at_end(page, service)
    assert evil in page.text("#reasons")
    assert page.evaluate("document.querySelectorAll('img, body script').length") == 0
