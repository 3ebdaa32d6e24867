# SPDX-License-Identifier: Apache-2.0
"""Token server: nothing behind it is reached without its token."""

from __future__ import annotations

import http.client
import os
import select
import socket
import threading
import time
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from stripe_newton.viewers.token_server import TokenServer


@pytest.fixture
def target():
    """Port of a web server, and the requests that have come to it."""
    seen = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            seen.append(self.path)
            self.send_response(200)
            self.end_headers()
            self.wfile.write(b"page" * 50_000)

        def log_message(self, *_):
            pass

    server = HTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield server.server_port, seen
    server.shutdown()
    server.server_close()


def ask(port: int, path: str, cookie: str = "") -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request("GET", path, headers={"Cookie": cookie} if cookie else {})
    return connection.getresponse()


def test_only_the_token_opens_it(target):
    port, seen = target
    server = TokenServer("127.0.0.1", 18500, port)
    second = TokenServer("127.0.0.1", server.port, port)  # the port is in use
    try:
        assert second.port > server.port
        assert second.token != server.token
        name = f"stripe-newton-{server.port}"
        for path, cookie in (
            ("/", ""),
            ("/?token=", ""),
            (f"/?token={second.token}", ""),
            ("/", f"{name}=x"),
            ("/", f"x{name}={server.token}"),
            (f"/?x={server.token}", ""),
        ):
            assert ask(server.port, path, cookie).status == 403
        # Without an end of the head nothing is passed on either.
        with socket.create_connection(("127.0.0.1", server.port), timeout=10) as rude:
            rude.sendall(b"x" * 100_000)
            assert rude.recv(100) == b""
        assert not seen
        first = ask(server.port, f"/?token={server.token}")
        assert (first.status, first.headers["Location"]) == (303, "/")
        assert "HttpOnly; SameSite=Strict" in first.headers["Set-Cookie"]
        assert not seen
        page = ask(server.port, "/a", "other=1; " + first.headers["Set-Cookie"].partition(";")[0])
        assert page.read() == b"page" * 50_000
        assert seen == ["/a"]
    finally:
        server.close()
        server.close()
        second.close()
    with pytest.raises(OSError):
        ask(server.port, "/")


def test_an_address_that_this_machine_lacks_is_an_error():
    with pytest.raises(OSError):
        TokenServer("192.0.2.1", 18500, 1)


def test_clients_that_send_nothing_take_few_files_and_end_without_a_word(target, capfd):
    port, _ = target
    server, clients = TokenServer("127.0.0.1", 18700, port), []
    before = len(os.listdir("/proc/self/fd"))
    try:
        for _ in range(300):
            client = socket.create_connection(("127.0.0.1", server.port), timeout=10)
            client.sendall(b"GET ")
            clients.append(client)
        # The server ends those beyond its bound, whose end of the connection then reads as empty.
        ended = 0
        deadline = time.monotonic() + 30.0
        while ended < 300 - 64 and time.monotonic() < deadline:
            ended = sum(bool(select.select([client], [], [], 0)[0]) for client in clients)
        assert ended >= 300 - 64
        assert len(os.listdir("/proc/self/fd")) - before - len(clients) <= 80
    finally:
        server.close()
        for client in clients:
            client.close()
    assert capfd.readouterr().err == ""
