"""Logs on a server: the same messages as of the file, and no other bytes fetched than are needed."""

import functools
import http.server
import json
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest
from mcap.writer import CompressionType

from fuselog.replay import open_log
from fuselog.schemas.errors import LogError

random = np.random.default_rng(1)
CHUNKS = [[(1000 * k + i, 0, 1 + k % 2, i, random.bytes(1000)) for i in range(100)] for k in range(20)]
ROWS = [row for chunk in CHUNKS for row in chunk]


class Handler(http.server.BaseHTTPRequestHandler):
    """Serves the files of a folder by ranges, and keeps what was asked for."""

    def __init__(self, server: "Server", *arguments: object) -> None:
        self.files = server
        super().__init__(*arguments)

    def do_GET(self) -> None:
        path = self.files.folder / unquote(urlsplit(self.path).path).lstrip("/")
        if not path.is_file():
            return self.answer(404)
        content = path.read_bytes()
        first, _, last = self.headers.get("Range", "").removeprefix("bytes=").partition("-")
        if not self.files.ranges:
            return self.answer(200, content)
        begin = int(first) if first else max(len(content) - int(last), 0)
        end = int(last) + 1 if first else len(content)
        if self.headers.get("If-Match") not in (None, self.files.tag):
            return self.answer(412)
        self.files.asked.append((begin, end))
        return self.answer(206, content[begin:end], f"bytes {begin}-{end - 1}/{len(content)}")

    def answer(self, status: int, content: bytes = b"", place: str = "") -> None:
        self.send_response(status)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("ETag", self.files.tag)
        self.send_header("Last-Modified", "Sun, 01 Nov 2026 08:00:00 GMT")
        if place:
            self.send_header("Content-Range", place)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        """Quiet."""


class Quiet(http.server.ThreadingHTTPServer):
    """Says nothing of clients that leave in the middle of an answer."""

    def handle_error(self, *_: object) -> None:
        """Nothing."""


class Server:
    """A web server of this machine with the files of ``folder``."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.ranges, self.tag = folder, True, '"one"'
        self.asked: list[tuple[int, int]] = []
        self.http = Quiet(("127.0.0.1", 0), functools.partial(Handler, self))
        self.thread = threading.Thread(target=self.http.serve_forever)
        self.thread.start()

    def url(self, name: str) -> str:
        return f"http://127.0.0.1:{self.http.server_port}/{name}"

    def close(self) -> None:
        self.http.shutdown()
        self.http.server_close()
        self.thread.join()


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    opened = Server(tmp_path)
    yield opened
    opened.close()


def fetched(server: Server) -> int:
    return sum(end - begin for begin, end in server.asked)


def test_the_messages_are_those_of_the_file(server: Server, make_log: Callable) -> None:
    size = make_log(CHUNKS).stat().st_size
    with open_log(server.url("log.mcap")) as log:
        assert [tuple(m) for m in log.messages()] == ROWS
        assert log.metadata() == {"source": {"who": "test"}}
        assert log.losses == []
    assert fetched(server) < size + (1 << 16) + (1 << 12)  # nothing twice but what both ends share with chunks


def test_opening_fetches_both_ends_and_a_window_its_chunks(server: Server, make_log: Callable) -> None:
    path = make_log(CHUNKS)
    with open_log(path) as log:
        chunks = [(chunk.offset, chunk.end) for chunk in log.parts[0]._contents.chunks]
    with open_log(server.url("log.mcap")) as log:
        size = path.stat().st_size
        assert server.asked == [(size - (1 << 16), size), (0, 1 << 12)]
        server.asked.clear()
        rows = [row for row in ROWS if 5000 <= row[0] < 8000 and row[2] == 2]
        assert [tuple(m) for m in log.messages("/b", start_ns=5000, end_ns=8000)] == rows
        assert sorted(server.asked) == [chunks[5], chunks[7]]
        server.asked.clear()
        assert next(log.messages("/a")).log_time == 0
        assert set(server.asked) <= {chunks[0], chunks[2], chunks[4], chunks[6]}  # some are fetched ahead


def test_a_log_without_summary_is_copied_and_read(server: Server, make_log: Callable) -> None:
    path = make_log(CHUNKS, compression=CompressionType.NONE)
    path.write_bytes(path.read_bytes()[:-100])
    with open_log(path) as local, open_log(server.url("log.mcap")) as log:
        assert [tuple(m) for m in log.messages()] == [tuple(m) for m in local.messages()] == ROWS
        assert [(loss.offset, loss.reason) for loss in log.losses] == [(x.offset, x.reason) for x in local.losses]
        assert all(loss.path == server.url("log.mcap") for loss in log.losses)


def test_small_logs_take_one_request(server: Server, make_log: Callable) -> None:
    make_log([CHUNKS[0][:10]])
    with open_log(server.url("log.mcap")) as log:
        assert [tuple(m) for m in log.messages()] == ROWS[:10]
    assert len(server.asked) == 1


def test_names_with_spaces_and_signed_queries_are_kept(server: Server, make_log: Callable) -> None:
    make_log([CHUNKS[0]], name="a log.mcap")
    with open_log(server.url("a%20log.mcap?signature=a%2Bb")) as log:
        assert len(list(log.messages())) == 100


def test_urls_and_files_are_one_log(server: Server, make_log: Callable) -> None:
    here = make_log(CHUNKS[:10], name="here.mcap")
    make_log(CHUNKS[10:], name="there.mcap")
    with open_log(Path(server.url("there.mcap")), here) as log:  # a path has one slash of the two
        assert [m.data for m in log.messages()] == [row[4] for row in ROWS]


def test_what_the_server_does_not_give_is_one_error(server: Server, make_log: Callable) -> None:
    make_log(CHUNKS)
    (server.folder / "empty.mcap").write_bytes(b"")
    (server.folder / "other.mcap").write_bytes(b"something else")
    for name, reason in (("absent.mcap", "absent"), ("other.mcap", "not an MCAP"), ("", "names no file")):
        with pytest.raises(LogError, match=reason):
            open_log(server.url(name))
    with pytest.raises(LogError, match="absent"):
        open_log(server.url("log.mcap"), server.url("absent.mcap"))
    server.ranges = False
    with pytest.raises(LogError, match=r"log\.mcap"):
        open_log(server.url("log.mcap"))


def test_a_file_that_is_replaced_while_it_is_read_is_one_error(server: Server, make_log: Callable) -> None:
    make_log(CHUNKS)
    with open_log(server.url("log.mcap")) as log:
        server.tag = '"two"'
        with pytest.raises(LogError, match=r"log\.mcap"):
            list(log.messages())


def test_reading_a_closed_log_is_one_error(server: Server, make_log: Callable) -> None:
    make_log(CHUNKS)
    with open_log(server.url("log.mcap")) as log:
        messages = log.messages()
        next(messages)
    with pytest.raises(LogError, match="the log is closed"):
        list(messages)


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str, bytes], str]]:
    """A bucket of S3 on this machine: puts a file there and gives its URL."""
    boto3 = pytest.importorskip("boto3", reason="boto3 absent")
    moto = pytest.importorskip("moto.server", reason="moto's server absent")
    for name, value in {
        "AWS_ACCESS_KEY_ID": "test",
        "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_REGION": "us-east-1",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_ALLOW_HTTP": "true",
    }.items():
        monkeypatch.setenv(name, value)
    running = moto.ThreadedMotoServer("127.0.0.1", port=0)
    running.start()
    host, port = running.get_host_and_port()
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
    client = boto3.client("s3", endpoint_url=f"http://{host}:{port}")
    client.create_bucket(Bucket="robots")

    def put(name: str, content: bytes) -> str:
        client.put_object(Bucket="robots", Key=name, Body=content)
        return f"s3://robots/{name}"

    yield put
    client.close()
    running.stop()


@pytest.mark.filterwarnings("default")  # of moto and its web server
def test_s3_gives_the_same(bucket: Callable[[str, bytes], str], make_log: Callable) -> None:
    url = bucket("2026/run 1/log.mcap", make_log(CHUNKS).read_bytes())
    with open_log(url) as log:
        assert [tuple(m) for m in log.messages()] == ROWS
        assert [tuple(m) for m in log.messages("/b", start_ns=5000, end_ns=8000)] == [
            row for row in ROWS if 5000 <= row[0] < 8000 and row[2] == 2
        ]
    with open_log(Path(url)) as log:
        assert log.time_range == (0, 19_099)
    with pytest.raises(LogError, match=r"absent\.mcap"):
        open_log("s3://robots/absent.mcap")


def test_google_cloud_storage_gives_the_same(
    server: Server, make_log: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the credentials that object stores of this kind have for tests: another address, and no signature."""
    account = {
        "gcs_base_url": f"http://127.0.0.1:{server.http.server_port}",
        "disable_oauth": True,
        "client_email": "",
        "private_key": "",
        "private_key_id": "",
    }
    (tmp_path / "account.json").write_text(json.dumps(account))
    monkeypatch.setenv("GOOGLE_SERVICE_ACCOUNT", str(tmp_path / "account.json"))
    monkeypatch.setenv("GOOGLE_ALLOW_HTTP", "true")
    place = tmp_path / "robots" / "2026" / "run 1"
    place.mkdir(parents=True)
    make_log(CHUNKS).rename(place / "log.mcap")
    with open_log("gs://robots/2026/run 1/log.mcap") as log:
        assert [tuple(m) for m in log.messages("/b", start_ns=5000, end_ns=8000)] == [
            row for row in ROWS if 5000 <= row[0] < 8000 and row[2] == 2
        ]
        assert fetched(server) < (place / "log.mcap").stat().st_size // 2
        assert [tuple(m) for m in log.messages()] == ROWS
    with pytest.raises(LogError, match=r"gs://robots/absent\.mcap"):
        open_log("gs://robots/absent.mcap")


def test_without_the_extra_the_error_says_what_to_install() -> None:
    script = (
        "import sys; sys.modules['obstore'] = None\n"
        "from fuselog.replay import open_log\n"
        "from fuselog.schemas.errors import LogError\n"
        "try:\n    open_log('s3://a/b.mcap')\nexcept LogError as error:\n    print(error)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert "s3://a/b.mcap: byte 0: URLs are read by another package: pip install 'fuselog[remote]'" in done.stdout
