# SPDX-License-Identifier: Apache-2.0
"""Local server: pages of other sites cannot connect to the live viewer, by the client of websockets."""

from __future__ import annotations

import pytest

viser = pytest.importorskip("viser")

import websockets.asyncio.server  # noqa: E402
from websockets.exceptions import InvalidStatus  # noqa: E402
from websockets.sync.client import connect  # noqa: E402

from stripe_newton.viewers.live.local_server import free_port, serve  # noqa: E402
from stripe_newton.viewers.token_server import TokenServer  # noqa: E402

SERVE = websockets.asyncio.server.serve


@pytest.fixture(scope="module")
def server():
    server = serve(free_port(), "test")
    yield server
    server.stop()


def ask(port, origin, cookie=""):
    return connect(
        f"ws://127.0.0.1:{port}",
        origin=origin,
        subprotocols=[f"viser-v{viser.__version__}"],
        additional_headers={"Cookie": cookie} if cookie else {},
        max_size=None,
    )


@pytest.mark.parametrize("origin", [None, "http://localhost:9000", "https://127.0.0.1", "http://[::1]:8080"])
def test_pages_of_this_machine_and_programs_connect(server, origin):
    with ask(server.get_port(), origin) as connection:
        assert connection.recv(timeout=10.0)


@pytest.mark.parametrize(
    "origin",
    ["https://example.com", "null", "http://localhost.example.com", "http://127.0.0.1:80@example.com", "file://", ""],
)
def test_pages_of_other_sites_are_refused(server, origin, capfd):
    with pytest.raises(InvalidStatus) as refused:
        ask(server.get_port(), origin)
    assert refused.value.response.status_code == 403


def test_a_refused_page_is_told(server, capfd):
    for _ in range(2):
        with pytest.raises(InvalidStatus):
            ask(server.get_port(), "https://told.example.com")
    assert capfd.readouterr().err.count("refused a page of 'https://told.example.com'") == 1


def test_the_token_opens_it_to_pages_of_its_own_address(server):
    outside = TokenServer("127.0.0.1", free_port(), server.get_port())
    try:
        cookie = f"stripe-newton-{outside.port}={outside.token}"
        with ask(outside.port, f"http://example.com:{outside.port}", cookie) as connection:
            assert connection.recv(timeout=10.0)
        with pytest.raises(InvalidStatus):
            ask(outside.port, f"http://example.com:{outside.port}")
    finally:
        outside.close()


def test_other_servers_of_websockets_stay_as_they_are(server):
    assert websockets.asyncio.server.serve is SERVE
