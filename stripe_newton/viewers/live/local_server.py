# SPDX-License-Identifier: Apache-2.0
"""Local server: viser's web server on the loopback interface, which pages of other sites cannot connect to."""

from __future__ import annotations

import contextlib
import functools
import http
import io
import re
import socket
import sys
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import viser
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

    Check = Callable[[ServerConnection, Request], Response | None]

__all__ = ["LOOPBACK", "free_port", "quiet", "serve"]

LOOPBACK = ("127.0.0.1", "localhost", "::1")
"""Addresses that only this machine reaches."""
_OWN_PAGE = re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")
"""Origins of pages of this machine, at any port: a tunnel of ssh may lead from another one."""


def serve(port: int, label: str) -> viser.ViserServer:
    """Start the web server: viser knows no tokens, and waits without end for a wrong host."""
    import viser  # here, as it is heavy, and an optional dependency

    with _refuse_other_pages(), quiet():
        return viser.ViserServer(host=LOOPBACK[0], port=port, label=label, verbose=False)


def free_port() -> int:
    """A port of the loopback interface that nobody uses."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK[0], 0))
        return int(probe.getsockname()[1])


def quiet() -> contextlib.redirect_stdout[io.StringIO]:
    """Keeps viser's announcements, which it makes in any case, from the output of a command."""
    return contextlib.redirect_stdout(io.StringIO())


@contextlib.contextmanager
def _refuse_other_pages() -> Iterator[None]:
    """Let servers of websockets that are started in this context refuse pages whose origin is not this machine.

    A browser lets every page connect to every WebSocket, also to one on the loopback interface, and says which page it
    is. viser has no option for a check of that.
    """
    import websockets.asyncio.server as module  # here, as it comes with viser

    start: Callable[..., object] = module.serve

    @functools.wraps(start)
    def start_with_check(*args: object, process_request: Check | None = None, **kwargs: object) -> object:
        return start(*args, process_request=functools.partial(_check, process_request), **kwargs)

    setattr(module, "serve", start_with_check)  # noqa: B010  (to type checkers it is a class)
    try:
        yield
    finally:
        setattr(module, "serve", start)  # noqa: B010


def _check(then: Check | None, connection: ServerConnection, request: Request) -> Response | None:
    """Refuse a request of a page of another site (403), else answer as ``then`` does. Programs send no origin."""
    for origin in request.headers.get_all("Origin"):
        if not _OWN_PAGE.fullmatch(origin):
            _tell_once(origin[:200])
            return connection.respond(http.HTTPStatus.FORBIDDEN, "pages of other sites are refused\n")
    return None if then is None else then(connection, request)


@functools.lru_cache(maxsize=8)
def _tell_once(origin: str) -> None:
    text = "must be opened as localhost, or through --host and its token"
    print(f"live viewer: refused a page of {origin!r}: the viewer {text}", file=sys.stderr, flush=True)
