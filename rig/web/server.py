"""A small web server on the standard library: three files, two pictures, one state, a few keys."""

from __future__ import annotations

import threading
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from socket import AF_INET6, socket
from typing import Any
from urllib.parse import parse_qs, urlsplit

from rig.core.errors import RigError
from rig.web.guard import CONTENT_SECURITY_POLICY, Guard
from rig.web.page import Page

Press = Callable[[str], bool]
"""Takes a key that somebody pressed on the page; False for a key that means nothing."""

_FILES = {
    "/": ("page.html", "text/html; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
}
_HERE = Path(__file__).parent
_LONGEST_KEY = 32
_POLL_S = 1.0
_MOST_CONNECTIONS = 16


class LiveServer(ThreadingHTTPServer):
    """Serves one page to those whom the guard lets in."""

    daemon_threads = True

    def __init__(self, host: str, port: int, token: str, page: Page, press: Press | None) -> None:
        if ":" in host:
            self.address_family = AF_INET6
        try:
            super().__init__((host, port), Handler)
        except OSError as error:
            raise RigError(
                f"--web-address {host}:{port} cannot be opened ({error.strerror}); "
                "name another port, or 0 for a free one"
            ) from error
        self.guard = Guard(host, int(self.server_address[1]), token)
        self.page = page
        self.press = press
        self._places = threading.BoundedSemaphore(_MOST_CONNECTIONS)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve one connection on a thread of its own, or drop it when there are too many."""
        if not self._places.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve one connection and give its place back."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._places.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing: a browser that goes away is no problem of the run."""


class Handler(BaseHTTPRequestHandler):
    """Answers one request."""

    server: LiveServer
    connection: socket
    timeout = 5.0
    server_version = "rig"
    sys_version = ""

    def do_GET(self) -> None:
        """Answer with a file, a picture, or the state."""
        url = urlsplit(self.path)
        query = parse_qs(url.query)
        token = query.get("token", [""])[0]
        if self._refused(token, writes=False):
            return
        if url.path == "/" and token:
            self._let_in()
        elif url.path in _FILES:
            name, kind = _FILES[url.path]
            self._answer(HTTPStatus.OK, (_HERE / name).read_bytes(), kind)
        elif url.path == "/state":
            after = query.get("after", ["0"])[0]
            number = int(after) if after.isdecimal() and len(after) < 16 else 0
            state = self.server.page.state_after(number, _POLL_S)
            self._answer(HTTPStatus.OK, state, "application/json")
        elif url.path in ("/primary.jpg", "/secondary.jpg"):
            picture = self.server.page.picture(url.path[1:-4])
            if picture is None:
                self._answer(HTTPStatus.NOT_FOUND, b"no picture yet")
            else:
                self._answer(HTTPStatus.OK, picture, "image/jpeg")
        else:
            self._answer(HTTPStatus.NOT_FOUND, b"not here")

    def do_POST(self) -> None:
        """Take a key of a calibration."""
        url = urlsplit(self.path)
        if self._refused(parse_qs(url.query).get("token", [""])[0], writes=True):
            return
        length = self.headers.get("content-length", "")
        if url.path != "/key" or self.server.press is None:
            self._answer(HTTPStatus.METHOD_NOT_ALLOWED, b"nothing can be changed here")
        elif not length.isdecimal() or int(length) > _LONGEST_KEY:
            self._answer(HTTPStatus.BAD_REQUEST, b"a key is one short word")
        elif self.server.press(self.rfile.read(int(length)).decode("utf-8", "replace")):
            self._answer(HTTPStatus.OK, b"{}", "application/json")
        else:
            self._answer(HTTPStatus.BAD_REQUEST, b"no such key")

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing: requests carry the token."""

    def _refused(self, token: str, *, writes: bool) -> bool:
        headers = {name.lower(): value for name, value in self.headers.items()}
        reason = self.server.guard.refuses(headers, token, writes=writes)
        if reason:
            self._answer(HTTPStatus.FORBIDDEN, f"refused: {reason}".encode())
        return bool(reason)

    def _let_in(self) -> None:
        """Put the token into a cookie, so that it leaves the address bar."""
        guard = self.server.guard
        cookie = f"{guard.cookie}={guard.token}; Path=/; HttpOnly; SameSite=Strict"
        self._answer(HTTPStatus.SEE_OTHER, b"", extra={"Location": "/", "Set-Cookie": cookie})

    def _answer(
        self,
        status: HTTPStatus,
        body: bytes,
        kind: str = "text/plain; charset=utf-8",
        extra: dict[str, str] | None = None,
    ) -> None:
        self.send_response(status)
        headers = {
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            "Cache-Control": "no-store",
            "Content-Security-Policy": CONTENT_SECURITY_POLICY,
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Cross-Origin-Opener-Policy": "same-origin",
        }
        for name, value in (headers | (extra or {})).items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)
