"""The status page in a real Chromium, over a real service whose filters fare differently."""

import json
import os
import re
import signal
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from fuselog.fusion.gate import chi_square_quantile

from . import chromium
from .chromium import Browser, Page
from .conftest import UNICYCLE, Service
from .status_service import EVIL, ROBOTS, StatusService

Serve = Callable[[str], Service]
Open = Callable[..., Page]


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
        page.call("Page.navigate", url="about:blank")  # ends its stream


@pytest.fixture(scope="module")
def service(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[StatusService]:
    """The service, with data that come all the time."""
    del browser  # without one nothing is to be started
    service = StatusService(tmp_path_factory.mktemp("status"))
    yield service
    service.close()


def shown(page: Page) -> dict[str, str]:
    """The statuses in the list."""
    rows = "[...document.querySelectorAll('#list li')]"
    return dict(page.evaluate(f"{rows}.map(e => [e.dataset.id, e.querySelector('.word').innerText])"))


def at_end(page: Page, service: StatusService) -> dict[str, str]:
    """Wait until all filters are there and the page shows each as the service says that it is."""
    end = time.monotonic() + 30
    while (listed := shown(page)) != (said := service.statuses()) or len(said) < ROBOTS + 6:
        assert time.monotonic() < end, (listed, said)
        time.sleep(0.1)
    return said


def found(pattern: str, text: str) -> str:
    """The first part of a text that is like this."""
    match = re.search(pattern, text)
    assert match is not None, (pattern, text)
    return match[0]


def choose(page: Page, id: str) -> None:
    """Choose a filter with the mouse."""
    page.click(f"#list [data-id='{id}']")
    page.wait(f"document.querySelector('#name').innerText === {json.dumps(id)}")


def test_filters_at_a_glance(service: StatusService, open_page: Open) -> None:
    """A row for each filter with its status and first reason, the worst first; words and buttons find some."""
    page = open_page(service.url)
    status = at_end(page, service)
    assert page.text("#connection") == "live"
    assert page.text("#list [data-id=well] .why") == "unicycle"
    assert status["rest"] == "initializing"
    rows = page.texts("#list li .id")
    assert sorted(rows) == sorted(status)
    order = ["diverged", "stale", "degraded", "initializing", "healthy"]
    assert [status[id] for id in rows] == sorted(status.values(), key=order.index)
    fleet = [id for id in rows if id.startswith("robot-") and status[id] == "healthy"]
    assert fleet == sorted(fleet, key=lambda id: int(id.removeprefix("robot-")))
    page.evaluate("document.querySelector('#search').focus()")
    page.type("robot-17")
    assert page.texts("#list li .id") == ["robot-17"]
    page.evaluate("document.querySelector('#search').value = ''")
    page.click("#counts button")  # of the worst status
    assert set(page.texts("#list li .word")) == {status[rows[0]]}
    assert page.evaluate("document.querySelector('#counts button').getAttribute('aria-pressed')") == "true"


def rates_agree(page: Page, service: StatusService) -> bool:
    """Whether the page shows the rates of the sensors as the service gives them, but for a moment's change."""
    rows, sensors = page.texts("#sensors tbody"), service.ask("/well/health")["sensors"]
    shown = [re.search(r"[\d.]+(?=\s*/ [\d.]+)", row) for row in rows]
    rates = [sensor["rate"] for sensor in sensors.values()]
    if None in shown or None in rates:
        return False
    return [float(match[0]) for match in shown if match] == pytest.approx([rate["hz"] for rate in rates], rel=0.05)


def until(holds: Callable[[], bool], *, within_s: float = 20.0) -> None:
    """Wait until something holds; fails where it does not in time."""
    end = time.monotonic() + within_s
    while not holds():
        assert time.monotonic() < end, "it does not come true"
        time.sleep(0.5)


def test_a_filter_and_its_sensors(service: StatusService, open_page: Open) -> None:
    """Status, reasons, rates, band of NIS and ledger of each sensor as the service says, while all of them move on."""
    page = open_page(service.url)
    at_end(page, service)
    choose(page, "well")
    page.wait("document.querySelectorAll('#sensors tbody').length === 3")
    before = service.ask("/well/health")["sensors"]
    page.wait("document.querySelector('#sensors svg.nis .band').getAttribute('visibility') === 'visible'")
    until(lambda: rates_agree(page, service))
    table = "[...document.querySelectorAll('#ledger tbody tr')].map(row => [...row.cells].map(cell => cell.innerText))"
    cells, rows = page.evaluate(table), page.texts("#sensors tbody")
    after = service.ask("/well/health")["sensors"]
    assert page.texts("#sensors .name") == list(after)
    for row, (name, sensor) in zip(rows, after.items(), strict=True):
        assert row.startswith(f"{name}\n")
        assert sensor["topic"] in row
        assert re.search(rf"\b{sensor['status']}\b", row)
    accounts = {row[0]: [int(cell.replace("\u202f", "")) for cell in row[1:4]] for row in cells}
    for name in after:
        for number, key in enumerate(("received", "fused", "gated")):
            assert before[name]["account"][key] <= accounts[name][number] <= after[name]["account"][key]
    assert accounts["all"] == [sum(accounts[name][n] for name in after) for n in range(3)]
    assert {row[-1] for row in cells} == {"exact"}


def test_changes_are_logged_and_said(service: StatusService, open_page: Open) -> None:
    """A camera falls silent: one line, with the time of day and the reason, and words for those who cannot see it."""
    page = open_page(service.url)
    at_end(page, service)
    page.evaluate(
        "window.said = []; new MutationObserver(() => said.push(document.querySelector('#announce').innerText))"
        ".observe(document.querySelector('#announce'), {childList: true, characterData: true, subtree: true})"
    )
    covered = datetime.now(UTC).replace(tzinfo=None)
    service.silence()
    page.wait("document.querySelector('#list [data-id=blind] .why').innerText.includes('camera')", 15)
    lines = [line for line in page.texts("#changes li") if "blind" in line and "camera: " in line and "silent" in line]
    assert len(lines) == 1
    told = datetime.fromisoformat(found(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d+(?= UTC)", lines[0]))
    assert 0 < (told - covered).total_seconds() < 15
    assert service.statuses()["blind"] in lines[0]
    assert any("blind is" in said and "silent" in said for said in page.evaluate("window.said"))
    page.wait("document.title.startsWith('(')")


def test_what_nobody_examined_is_a_dash(service: StatusService, open_page: Open) -> None:
    """A filter without a sample, and figures that nobody has."""
    page = open_page(service.url)
    at_end(page, service)
    choose(page, "rest")
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
def test_nis_and_its_band(
    service: StatusService, open_page: Open, nis: dict[str, Any], words: str, inside: str | None
) -> None:
    """Mark and band in the picture are where the words say, on a scale with the expected value at a third."""
    page = open_page(service.url)
    sensors = {
        "gps": {"status": "ok", "nis": nis, "rate": {"hz": 9.5}, "not_examined": {"nis": "too few"}, "new": {"a": [1]}}
    }
    page.evaluate(
        "import('/page/sensors.js').then(m => { const table = document.createElement('table'); table.id = 'alone';"
        f" document.body.append(table); m.showSensors(table, {json.dumps(sensors)}) }})"
    )
    assert page.evaluate("document.querySelector('#alone span.nis').textContent") == words
    assert page.evaluate("document.querySelector('#alone .second').parentNode.textContent") == "9.50 / –not examined"
    picture = "document.querySelector('#alone .{}')"
    assert page.evaluate(f"{picture.format('mark')}.getAttribute('data-inside')") == inside
    if nis["mean"] is None:
        assert page.evaluate(f"getComputedStyle({picture.format('mark')}).visibility") == "hidden"
        return
    box = page.evaluate(f"(b => [b.x, b.width])({picture.format('mark')}.getBBox())")
    assert abs(box[0] + box[1] / 2 - min(35 * nis["mean"] / nis["dof"], 100.5)) < 0.1
    if "band" in nis:
        band = page.evaluate(f"(b => [b.x, b.x + b.width])({picture.format('band')}.getBBox())")
        np.testing.assert_allclose(band, [35 * end / nis["dof"] for end in nis["band"]])


def test_ellipse_holds_95_percent(service: StatusService, open_page: Open) -> None:
    """Half axes and direction against numpy's eigenvectors."""
    page = open_page(service.url)
    P = np.array([[4.0, 1.5], [1.5, 1.0]])
    found = page.evaluate(f"import('/page/map.js').then(m => m.ellipseOf({P.tolist()}))")
    variances, axes = np.linalg.eigh(P)
    np.testing.assert_allclose([found["b"], found["a"]], np.sqrt(variances * chi_square_quantile(0.95, 2)), rtol=1e-4)
    np.testing.assert_allclose(abs(axes[:, 1] @ [np.cos(found["angle"]), np.sin(found["angle"])]), 1, rtol=1e-9)


def test_figures_as_people_read_them(service: StatusService, open_page: Open) -> None:
    """Three digits, a unit that suits, and nothing where there is nothing."""
    page = open_page(service.url)
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


def test_events_in_any_pieces(service: StatusService, open_page: Open) -> None:
    """A stream cut after every byte, with both line ends, comments, several lines of data, and other fields."""
    page = open_page(service.url)
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
def test_everything_can_be_read(service: StatusService, open_page: Open, dark: bool) -> None:
    """Contrast of at least 4.5 for every text and shape, light and dark (WCAG 2.2, 1.4.3)."""
    page = open_page(service.url, dark=dark)
    at_end(page, service)
    ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (ground == "rgb(255, 255, 255)") is not dark
    contrasts = page.evaluate(CONTRASTS)
    assert len(contrasts) > 100
    assert contrasts[0][0] >= 4.5, contrasts[0]


def test_map_and_states(service: StatusService, open_page: Open) -> None:
    """The trail ends at the estimate; a model without a plane has sparklines alone."""
    page = open_page(service.url)
    at_end(page, service)
    choose(page, "well")
    page.wait("document.querySelector('#map .trail').points.length > 5")
    words, here, trail = page.evaluate(
        "[document.querySelector('#map-words').innerText,"
        " [...document.querySelectorAll('#map .here')].map(c => [c.cx.baseVal.value, c.cy.baseVal.value])[0],"
        " [...document.querySelector('#map .trail').points].map(p => [p.x, p.y])]"
    )
    assert trail[-1] == here
    x, y = (float(text) for text in re.findall(r"\b[xy] (\S+) m", words.replace("−", "-")))
    assert abs(np.hypot(x, y - 1 / 0.3) - 1 / 0.3) < 0.5  # on the circle that the robot drives
    choose(page, "line")
    assert page.evaluate("getComputedStyle(document.querySelector('#map-figure')).display") == "none"
    assert page.texts("#states tbody th") == ["x", "vx"]
    page.wait("document.querySelector('#states .band').getAttribute('d').length > 50")


def test_any_width(service: StatusService, open_page: Open) -> None:
    """A telephone, a window of 1,280 pixels at 200 %, and wider: nothing sticks out, every figure has its name."""
    page = open_page(service.url)
    at_end(page, service)
    choose(page, "sure")
    age = "document.querySelector('#sensors td[data-label=Age]')"
    for width in (360, 640, 1150, 1280, 1920):
        page.look(width=width)
        page.wait(f"innerWidth === {width}")
        assert page.evaluate("document.documentElement.scrollWidth") <= width, width
        label = page.evaluate(f"getComputedStyle({age}, '::before').content")
        heading = page.evaluate("document.querySelector('#sensors thead').getBoundingClientRect().height")
        assert (label == '"Age"') is not (heading > 10), width


def test_theme_is_remembered(service: StatusService, open_page: Open) -> None:
    """System, light, dark: the choice outlives a reload, and the system's does not change it."""
    page = open_page(service.url)
    seen: list[tuple[str, str]] = []
    for _ in range(3):
        page.click("#theme")
        seen.append((page.evaluate("document.documentElement.className"), page.text("#theme")))
    assert seen == [("light", "Colours: light"), ("dark", "Colours: dark"), ("", "Colours: system")]
    page.click("#theme")
    page.click("#theme")
    page.go(service.url)
    page.wait("document.documentElement.className === 'dark'")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(20, 24, 31)"


def test_keys(service: StatusService, open_page: Open) -> None:
    """Without a mouse: past the list or through it, and on to the chosen filter."""
    page = open_page(service.url)
    at_end(page, service)
    page.press("Tab")
    assert page.evaluate("document.activeElement.className") == "skip"
    assert page.evaluate("document.activeElement.getBoundingClientRect().top") >= 0
    page.evaluate("document.querySelector('#list').focus()")
    page.press("End")
    last = page.text("#name")
    page.press("ArrowUp")
    id = page.text("#name")
    assert id != last
    active = "document.getElementById(document.querySelector('#list').getAttribute('aria-activedescendant')).dataset.id"
    assert page.evaluate(active) == id
    assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    page.press("Enter")
    assert page.evaluate("document.activeElement.id") == "detail"
    page.wait(f"location.hash === '#filter={id}'")
    page.go(f"{service.url}/#filter=well")
    page.wait("document.querySelector('#name').innerText === 'well'")


def test_texts_of_others_are_texts(service: StatusService, open_page: Open) -> None:
    """What a publisher says of itself may look like HTML."""
    page = open_page(service.url)
    at_end(page, service)
    choose(page, "odd")
    page.wait(f"document.querySelector('#detail').innerText.includes({json.dumps(EVIL)})")
    assert page.evaluate("document.querySelectorAll('img, body script').length") == 0


def test_token(serve: Serve, open_page: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    """Asked for, refused when wrong, sent in a header only, kept for this tab only, and forgotten."""
    token = "right-token-of-at-least-forty-three-characters"
    monkeypatch.setenv("FUSELOG_TOKEN_READ", token)
    url = serve(UNICYCLE).url
    page = open_page(url)
    page.wait("!document.querySelector('#token').hidden")
    assert page.texts("#list li") == []
    assert page.evaluate("document.activeElement.id") == "token-input"
    page.type(token.replace("right", "wrong"))
    page.press("Enter")
    page.wait("document.querySelector('#token-why').innerText.includes('refused the token')")
    page.type(token)
    page.press("Enter")
    page.wait("document.querySelector('#list li')")
    assert page.evaluate("document.querySelector('#token').hidden")
    page.go(url)
    page.wait("document.querySelector('#list li')")  # the tab remembers
    assert token not in page.evaluate("JSON.stringify(localStorage) + document.cookie + location.href")
    assert not any(token in request["url"] for request in page.requests)
    page.click("#forget")
    page.wait("!document.querySelector('#token').hidden")
    assert page.evaluate("sessionStorage.length") == 0
    open_page(url).wait("!document.querySelector('#token').hidden")


def test_silence_and_loss_of_the_service_show(serve: Serve, open_page: Open) -> None:
    """Data that are old are called so; so is a service that is gone."""
    service = serve(UNICYCLE)
    page = open_page(service.url)
    connection = "document.querySelector('#connection').innerText"
    page.wait(f"{connection} === 'live'")
    os.kill(service.process.pid, signal.SIGSTOP)
    page.wait(f"/^stale since [3-9] s$/.test({connection})", 10)
    os.kill(service.process.pid, signal.SIGCONT)
    page.wait(f"{connection} === 'live'", 10)
    assert service.end()[0] == 0
    page.wait(f"/reconnecting in \\d+ s/.test({connection})", 15)
