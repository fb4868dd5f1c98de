"""Only the browser that was given the page's address may connect to the viewer.

Any web page that the user has open may send requests to this computer, so the server checks three things:
`Host` names this computer (against DNS rebinding), `Origin`, if present, is the page's own, and the token in
the address, or the cookie that the first request with it sets, is right.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from inspect import isawaitable
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from registry import RunError

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

NAMES = ("127.0.0.1", "localhost", "::1")
"""Names of this computer in `Host`; the port may differ, because it may be forwarded."""


class Guard:
    """Checks each request before the server answers it.

    Attributes:
        token: what the page's address must carry.
    """

    def __init__(self) -> None:
        self.token = secrets.token_urlsafe(16)
        # Viewers on other ports of this computer share its cookies, so each has a name of its own.
        self._cookie = f"stereogs-{secrets.token_hex(4)}"

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Guard the server that is started within; viser has no option for it.

        Raises:
            RunError: no server was started with websockets' `serve`, so nothing would be checked.
        """
        from websockets.asyncio import server

        original, started = server.serve, False

        def serve(*arguments: Any, process_request: Any = None, **options: Any) -> Any:
            nonlocal started
            started = True

            async def guarded(connection: ServerConnection, request: Request) -> Any:
                return await self._answer(connection, request, process_request)

            return original(*arguments, process_request=guarded, **options)

        server.serve = serve  # type: ignore[assignment, misc]
        try:
            yield
        finally:
            server.serve = original  # type: ignore[misc]
        if not started:
            raise RunError(
                "the viewer cannot be protected from other web pages with this version of viser",
                fix="pip install 'viser==1.1.1'",
            )

    async def _answer(self, connection: ServerConnection, request: Request, then: Any) -> Any:
        reason = self.objection(request)
        if reason:
            return connection.respond(HTTPStatus.FORBIDDEN, f"{reason}\n")
        response: Response | None = then(connection, request) if then else None
        if isawaitable(response):
            response = await response
        if response is not None and self._has_token(request):
            response.headers["Set-Cookie"] = (
                f"{self._cookie}={self.token}; Path=/; HttpOnly; SameSite=Strict"
            )
        return response

    def objection(self, request: Request) -> str:
        """Return why a request is refused; empty if it is not."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(hosts) != 1 or _host_name(hosts[0]) not in NAMES:
            return "This page is served to this computer only."
        if any(origin != f"http://{hosts[0]}" for origin in origins):
            return "Another web page asked for this scene."
        if request.path.startswith(
            "//"
        ):  # a host in place of a path, which viser would try to read
            return "There is no such page."
        if not self._has_token(request) and not self._has_cookie(request):
            return "Open the whole address that the command printed, with its token."
        return ""

    def _has_token(self, request: Request) -> bool:
        try:
            query = urlsplit(request.path).query
        except ValueError:  # such as //[
            return False
        return self._is_token(parse_qs(query).get("token", [""])[-1])

    def _has_cookie(self, request: Request) -> bool:
        for header in request.headers.get_all("Cookie"):
            try:
                cookies = SimpleCookie(header)
            except CookieError:
                continue
            if self._cookie in cookies and self._is_token(cookies[self._cookie].value):
                return True
        return False

    def _is_token(self, given: str) -> bool:
        return secrets.compare_digest(given.encode(), self.token.encode())


def _host_name(host: str) -> str | None:
    """Return the name in a `Host` header, without its port; None if it is not one."""
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None
