"""A log on a server, read by ranges: of S3, Google Cloud Storage, or plain HTTP."""

import mmap
import posixpath
import tempfile
from concurrent.futures import Future, ThreadPoolExecutor
from datetime import timedelta
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlsplit, urlunsplit

import numpy as np
import obstore
from numpy.typing import NDArray
from obstore.exceptions import BaseError
from obstore.store import GCSStore, HTTPStore, ObjectStore, S3Store

from fuselog.schemas.errors import LogError

if TYPE_CHECKING:
    from obstore.store import RetryConfig  # only there for checkers

_TAIL = 1 << 16  # bytes fetched first: they hold the footer, and most summaries
_HEAD = 1 << 12  # bytes fetched together at the beginning
_STEP = 8 << 20  # bytes fetched at a time of a file that is needed as a whole
_AT_ONCE = 4  # requests

Bytes = NDArray[np.uint8]


class RemoteFile:
    """A file behind a URL, as a `Source`: only what is read is fetched. Raises LogError when it cannot be had.

    Where all of it is needed, because a log has no summary, it is copied into a temporary file without a name. A file
    that is replaced while it is read is an error, if the server gives entity tags.
    """

    def __init__(self, url: str) -> None:
        self.path = url
        self._etag: str | None = None
        self._copy: Bytes | None = None
        self._coming: dict[tuple[int, int], Future[Bytes]] = {}
        self._threads: ThreadPoolExecutor | None = ThreadPoolExecutor(_AT_ONCE, "fetch")
        try:
            self._store, self._key = _locate(url)
            self.size, self._tail = self._get_tail()
        except BaseException:
            self.close()
            raise
        self._head = self._tail[:_HEAD] if len(self._tail) == self.size else None

    def fetch(self, begin: int, end: int) -> None:
        """Begin to fetch [begin, end), which will be read soon."""
        if self._threads is not None and self._kept(begin, end) is None and (begin, end) not in self._coming:
            self._coming[begin, end] = self._threads.submit(self._get, begin, end)

    def read(self, begin: int, end: int) -> Bytes:
        """The bytes of [begin, end)."""
        begin, end = min(max(begin, 0), self.size), min(max(end, 0), self.size)
        if self._threads is None:
            raise LogError(self.path, begin, "the log is closed")
        if begin < _HEAD and end <= _HEAD and self._head is None:
            self._head = self._get(0, _HEAD)
        kept = self._kept(begin, end)
        if kept is not None:
            return kept
        coming = self._coming.pop((begin, end), None)
        return self._get(begin, end) if coming is None else coming.result()

    def read_all(self) -> Bytes:
        """All bytes, from a copy that is made the first time."""
        if self._copy is None:
            with tempfile.TemporaryFile() as file:
                for begin in range(0, self.size, _STEP):
                    file.write(self.read(begin, begin + _STEP).data)
                file.flush()
                self._copy = np.frombuffer(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ), np.uint8)
        return self._copy

    def close(self) -> None:
        """Give up what is still coming; bytes that were handed out stay valid."""
        if self._threads is not None:
            self._threads.shutdown(wait=False, cancel_futures=True)
        self._threads, self._copy = None, None
        self._coming.clear()

    def _kept(self, begin: int, end: int) -> Bytes | None:
        """The bytes of [begin, end), if they were fetched with others."""
        if self._copy is not None:
            return self._copy[begin:end]
        first = self.size - len(self._tail)
        if begin >= first or begin >= end:
            return self._tail[begin - first : end - first]
        return self._head[begin:end] if self._head is not None and end <= len(self._head) else None

    def _get_tail(self) -> tuple[int, Bytes]:
        """(size of the file, its last bytes)."""
        try:
            found = obstore.get(self._store, self._key, options={"range": {"suffix": _TAIL}})
            size, self._etag = found.meta["size"], found.meta["e_tag"]
            return size, np.frombuffer(memoryview(found.bytes()), np.uint8)
        except (BaseError, OSError, ValueError) as error:
            raise LogError(self.path, 0, _reason(error)) from error

    def _get(self, begin: int, end: int) -> Bytes:
        strong = self._etag if self._etag is not None and not self._etag.startswith("W/") else None
        try:
            found = obstore.get(self._store, self._key, options={"range": (begin, end), "if_match": strong})
            data = np.frombuffer(memoryview(found.bytes()), np.uint8)
        except (BaseError, OSError, ValueError) as error:
            raise LogError(self.path, begin, _reason(error)) from error
        if len(data) != end - begin:
            raise LogError(self.path, begin, f"{len(data)} bytes came of {end - begin}")
        return data


def _locate(url: str) -> tuple[ObjectStore, str]:
    """(the store, the name of the file in it); raises LogError for a URL that names no file."""
    parts = urlsplit(url)
    retry: RetryConfig = {"max_retries": 3, "retry_timeout": timedelta(seconds=30)}
    try:
        if parts.scheme in ("http", "https"):
            folder, name = posixpath.split(parts.path)
            base = urlunsplit((parts.scheme, parts.netloc, folder, parts.query, ""))
            store = HTTPStore.from_url(base, client_options={"allow_http": parts.scheme == "http"}, retry_config=retry)
            key = unquote(name)
        else:
            kind = S3Store if parts.scheme == "s3" else GCSStore
            store = kind.from_url(f"{parts.scheme}://{parts.netloc}", retry_config=retry)
            key = parts.path.lstrip("/")
    except (BaseError, ValueError) as error:
        raise LogError(url, 0, _reason(error)) from error
    if not key:
        raise LogError(url, 0, "names no file")
    return store, key


def _reason(error: Exception) -> str:
    """What went wrong, in one line."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0] if lines else type(error).__name__
