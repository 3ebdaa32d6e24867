# SPDX-License-Identifier: Apache-2.0
"""Token server: lets other machines reach a web server of this one, if they have its token."""

from __future__ import annotations

import asyncio
import contextlib
import re
import secrets
import threading

__all__ = ["TokenServer"]

_HEAD_BYTES = 16384
"""Longest head of a request."""
_HEAD_S = 10.0
"""Seconds that a client has to send it."""
_MOST_WAITING = 64
"""Most clients that have not sent it yet: each takes an open file, which checkpoints need, too."""
_PORTS = 100
"""Ports that are tried, beginning with the one that was asked for."""
_TOKEN_IN_PATH = re.compile(rb"[?&]token=([\w-]+)")

_ORIGIN = re.compile(rb"(?im)^origin:.*\r\n")


class TokenServer:
    """Listens on an address, and passes connections on to a server on the loopback interface.

    A browser gives the token once, in the address, and keeps it as a cookie. Requests without it get an error (403) and
    reach nothing. The connection is not encrypted.

    Args:
        host: Address to listen on.
        port: Port; the next free one is taken if it is in use.
        target: Port of the server on the loopback interface.

    Raises:
        OSError: if there is no such address, or all ports are in use.
    """

    def __init__(self, host: str, port: int, target: int):
        self.token = secrets.token_urlsafe(24)
        self._target, self._waiting = target, 0
        self._server: asyncio.Server | None = None
        # A loop in a thread of its own from the start: that of the caller may have one, as in a notebook.
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="token_server", daemon=True)
        self._thread.start()
        try:
            self._server = asyncio.run_coroutine_threadsafe(self._listen(host, port), self._loop).result()
        except BaseException:
            self.close()
            raise
        self.port: int = self._server.sockets[0].getsockname()[1]
        """The port that it listens on."""
        self._cookie = f"stripe-newton-{self.port}"

    def _run(self) -> None:
        """Serve until :meth:`close`, and end what is then still there."""
        self._loop.run_forever()
        if self._server is not None:
            self._server.close()
        for task in asyncio.all_tasks(self._loop):
            task.cancel()
        self._loop.run_until_complete(asyncio.sleep(0.0))
        self._loop.close()

    async def _listen(self, host: str, port: int) -> asyncio.Server:
        for number in range(port, port + _PORTS):
            try:
                return await asyncio.start_server(self._serve, host, number, limit=_HEAD_BYTES)
            except OSError:
                # Only a port in use is no reason to give up: the same address with any port shows which it is.
                if number == port:
                    (await asyncio.start_server(self._serve, host, 0)).close()
        raise OSError(f"no free port from {port} to {port + _PORTS - 1}")

    def close(self) -> None:
        """End all connections and stop listening. A second call does nothing."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        ends = OSError, EOFError, asyncio.LimitOverrunError, TimeoutError, asyncio.TimeoutError
        # Also cancelled by `close`: browsers keep connections open that they have not used.
        with contextlib.suppress(*ends, asyncio.CancelledError):
            try:
                head = await self._head(reader)
                given = _TOKEN_IN_PATH.search(head.partition(b"\r\n")[0])
                if given is not None and self._is_token(given[1]):
                    # Once with the token as a cookie, so that the address in the browser does not show it any longer.
                    cookie = f"Set-Cookie: {self._cookie}={self.token}; Path=/; HttpOnly; SameSite=Strict"
                    writer.write(_response("303 See Other", "Location: /", cookie))
                elif self._has_cookie(head):
                    await self._pass_on(head, reader, writer)
                else:
                    writer.write(_response("403 Forbidden"))
                await writer.drain()
            finally:
                writer.close()

    async def _head(self, reader: asyncio.StreamReader) -> bytes:
        """The head of a request.

        Raises:
            OSError: if too many other clients are waited for.
        """
        if self._waiting >= _MOST_WAITING:
            raise OSError("too many clients")
        self._waiting += 1
        try:
            return await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), _HEAD_S)
        finally:
            self._waiting -= 1

    def _is_token(self, given: bytes) -> bool:
        return secrets.compare_digest(given, self.token.encode())

    def _has_cookie(self, head: bytes) -> bool:
        cookies = re.findall(rb"[;:]\s*%s=([\w-]+)" % self._cookie.encode(), head)
        return any(self._is_token(cookie) for cookie in cookies)

    async def _pass_on(self, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Send a request to the server, and then whatever both sides send, until one of them ends."""
        server_reader, server_writer = await asyncio.open_connection("127.0.0.1", self._target)
        try:
            # The cookie has shown whose page it is; the server knows the pages of this machine alone.
            server_writer.write(_ORIGIN.sub(b"", head))
            ways = [
                asyncio.ensure_future(_copy(reader, server_writer)),
                asyncio.ensure_future(_copy(server_reader, writer)),
            ]
            try:
                await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for way in ways:
                    way.cancel()
        finally:
            server_writer.close()


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError):
        while content := await reader.read(1 << 16):
            writer.write(content)
            await writer.drain()


def _response(status: str, *headers: str) -> bytes:
    lines = [f"HTTP/1.1 {status}", *headers, "Content-Length: 0", "Connection: close"]
    return ("\r\n".join(lines) + "\r\n\r\n").encode()
