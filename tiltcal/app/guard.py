"""Who may talk to the application: the browser that was given the token, by this address.

Every request and every websocket passes here first: pages, scripts, uploads and files of the
workspace alike.
"""

import re
import secrets
from collections.abc import Awaitable, Callable, MutableMapping, Sequence
from http.cookies import CookieError, SimpleCookie
from ipaddress import ip_address
from typing import Any
from urllib.parse import parse_qs

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]
Header = tuple[bytes, bytes]

TOKEN_BYTES = 32  # 256 bits: not guessed
SAFE = ("GET", "HEAD")
POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval';"
    " style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:;"
    " connect-src 'self'; frame-src 'self'; object-src 'none'; base-uri 'none';"
    " form-action 'self'; frame-ancestors 'self'"
)
"""What a page may load: nothing from outside. Vue compiles its templates in the browser, which
needs 'unsafe-eval'; text from files is never part of a template.
"""
HEADERS: Sequence[Header] = (
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
)
ENTERED = (
    '<!doctype html><html lang="en"><title>tiltcal</title>'
    '<meta http-equiv="refresh" content="0;url=/"><a href="/">Continue</a></html>'
)
"""A page of this origin, and no redirection: a strict cookie is not sent along a redirection that
began on another site, such as a mail in the browser.
"""


class Keys:
    """The token of the printed address, and the cookie that it is exchanged for.

    Args:
        token: given by the user, exchanged as often as it comes; None: one is drawn that is
            exchanged once.
        port: that the cookie belongs to: browsers do not tell ports apart.
    """

    def __init__(self, token: str | None, port: int) -> None:
        self.token = token or secrets.token_urlsafe(TOKEN_BYTES)
        self.cookie = f"tiltcal_{port}"
        self._secret = secrets.token_urlsafe(TOKEN_BYTES)
        self._once = token is None
        self._used = False

    def exchange(self, given: str) -> str | None:
        """The Set-Cookie header for a token; None where it is wrong, or was used."""
        if self._used or not secrets.compare_digest(given.encode(), self.token.encode()):
            return None
        self._used = self._once
        return f"{self.cookie}={self._secret}; HttpOnly; SameSite=Strict; Path=/"

    def admits(self, cookies: str) -> bool:
        """Whether a Cookie header holds what a token was exchanged for."""
        try:
            held = SimpleCookie(cookies).get(self.cookie)
        except CookieError:
            return False
        return held is not None and secrets.compare_digest(
            held.value.encode(), self._secret.encode()
        )


class Guard:
    """The application behind its checks of host, origin and cookie.

    Args:
        app: behind it.
        keys: of the browser.
        host: that the user named, and may be called by.
        port: that it listens on.
    """

    def __init__(self, app: Application, keys: Keys, host: str, port: int) -> None:
        self.app, self.keys = app, keys
        self._names, self._port = {"localhost", host.lower()}, port

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = {k.decode("latin-1").lower(): v.decode("latin-1") for k, v in scope["headers"]}
        host = headers.get("host", "")
        if not self.is_ours(host):
            await _refuse(scope, send, 400, "wrong host: use the address that tiltcal printed")
        elif not _is_same_origin(scope, headers, host):
            await _refuse(scope, send, 403, "a request from another page")
        elif (token := _token_of(scope)) is not None:
            await self._enter(scope, send, token)
        elif not self.keys.admits(headers.get("cookie", "")):
            await _refuse(
                scope, send, 401, "no session: open the address with the token that tiltcal printed"
            )
        else:
            await self.app(scope, receive, _with_headers(send))

    def is_ours(self, host: str) -> bool:
        """Whether a Host header names this server: by number, as localhost, or as the user did.
        Another name that leads here (DNS rebinding) does not.
        """
        found = re.fullmatch(r"(\[[0-9a-fA-F:.]+\]|[^:\[\]]+)(?::(\d+))?", host)
        if found is None or int(found[2] or 80) != self._port:
            return False
        name = found[1].strip("[]").lower()
        return name in self._names or _is_number(name)

    async def _enter(self, scope: Scope, send: Send, token: str) -> None:
        cookie = self.keys.exchange(token)
        if cookie is None:
            text = "wrong or used token: start tiltcal app again for a new one"
            await _refuse(scope, send, 403, text)
            return
        headers = [(b"set-cookie", cookie.encode()), (b"cache-control", b"no-store"), *HEADERS]
        await _answer(send, 200, "text/html", ENTERED, headers)


def _is_number(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


def _token_of(scope: Scope) -> str | None:
    """The token of the address that was printed, where this is it."""
    if scope["type"] != "http" or scope["path"] != "/" or scope["method"] != "GET":
        return None
    values = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token")
    return values[0] if values else None


def _is_same_origin(scope: Scope, headers: MutableMapping[str, str], host: str) -> bool:
    """Whether a page of this origin asks, as far as the browser tells; a link may come from
    anywhere, but what changes something may not, nor a websocket. Other ports of this machine are
    the same site to a cookie, not the same origin.
    """
    origin = headers.get("origin")
    if origin is not None and origin != f"http://{host}":
        return False
    if scope["type"] == "websocket":
        return origin is not None
    navigating = headers.get("sec-fetch-mode") == "navigate" and scope["method"] in SAFE
    return navigating or headers.get("sec-fetch-site", "none") in ("none", "same-origin")


def _with_headers(send: Send) -> Send:
    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = list(message.get("headers", []))
            if not any(name.lower() == b"content-security-policy" for name, _ in headers):
                headers.append((b"content-security-policy", POLICY.encode()))
            message["headers"] = [*headers, *HEADERS]
        await send(message)

    return sent


async def _refuse(scope: Scope, send: Send, status: int, text: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": text})
    else:
        await _answer(send, status, "text/plain", f"tiltcal: {text}\n", HEADERS)


async def _answer(send: Send, status: int, kind: str, text: str, headers: Sequence[Header]) -> None:
    body = text.encode()
    fixed = [
        (b"content-type", f"{kind}; charset=utf-8".encode()),
        (b"content-length", str(len(body)).encode()),
    ]
    await send({"type": "http.response.start", "status": status, "headers": [*fixed, *headers]})
    await send({"type": "http.response.body", "body": body})
