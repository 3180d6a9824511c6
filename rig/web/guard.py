"""Who may ask the live page for something. A loopback address is no boundary: every page that is
open in a browser on this computer can send requests to it.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie

from rig.core.errors import UsageError

SHORTEST_TOKEN = 16

CONTENT_SECURITY_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


@dataclass(frozen=True, slots=True)
class Guard:
    """The address that the page is served at, and the token that opens it."""

    host: str
    port: int
    token: str

    @property
    def names(self) -> frozenset[str]:
        """Return the values of the Host header that mean this server."""
        hosts = {_bracketed(self.host)}
        if is_loopback(self.host):
            hosts |= {"localhost", "127.0.0.1"} if ":" not in self.host else {"localhost"}
        return frozenset(f"{host}:{self.port}" for host in hosts)

    @property
    def cookie(self) -> str:
        """Return the name of the cookie; browsers share cookies between ports."""
        return f"rig-{self.port}"

    @property
    def url(self) -> str:
        """Return the address to open, token included."""
        return f"http://{_bracketed(self.host)}:{self.port}/?token={self.token}"

    def refuses(self, headers: Mapping[str, str], query_token: str, *, writes: bool) -> str:
        """Return why a request is refused; empty when it may pass.

        `headers` have lower-case names. A request that changes something must say where it comes
        from; one that reads must not come from elsewhere.
        """
        if headers.get("host", "") not in self.names:
            return "unknown Host"
        origin = headers.get("origin")
        if origin is None and writes:
            return "no Origin"
        if origin is not None and origin not in {f"http://{name}" for name in self.names}:
            return "foreign Origin"
        if headers.get("sec-fetch-site", "none") not in ("none", "same-origin"):
            return "request from another site"
        if not (self._is_token(query_token) or self._is_token(self._cookie_of(headers))):
            return "no valid token"
        return ""

    def _cookie_of(self, headers: Mapping[str, str]) -> str:
        try:
            cookie = SimpleCookie(headers.get("cookie", "")).get(self.cookie)
        except CookieError:
            return ""
        return cookie.value if cookie else ""

    def _is_token(self, words: str) -> bool:
        return hmac.compare_digest(words.encode(), self.token.encode())


def parse_listen(address: str, token: str | None) -> tuple[str, int, str]:
    """Return host, port and token of `127.0.0.1:0`.

    Raises UsageError for what is no address, for one that names every interface, and for one
    that others can reach when no token of at least 16 characters is given.
    """
    host, colon, port = address.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not (colon and host and port.isdecimal() and int(port) < 65_536):
        raise UsageError(f"--web-address {address!r}: write HOST:PORT, such as 127.0.0.1:8080")
    if host in ("0.0.0.0", "::"):
        raise UsageError(
            f"--web-address {address}: name one address of this computer, not every one at once"
        )
    if token is not None and len(token) < SHORTEST_TOKEN:
        raise UsageError(f"--web-token: at least {SHORTEST_TOKEN} characters, got {len(token)}")
    if token is None and not is_loopback(host):
        raise UsageError(
            f"--web-address {address}: others can reach it; give a --web-token that only the "
            "right ones know"
        )
    return host, int(port), token or secrets.token_urlsafe(24)


def is_loopback(host: str) -> bool:
    """Return whether only this computer can reach an address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host
