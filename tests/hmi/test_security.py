"""Requests to the page: own host and origin, log-in, cookie, headers, WebSocket."""

from pathlib import Path

import pytest
from fastapi import FastAPI, WebSocket
from fastapi.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from hmi.access import Access, add_user, read_users
from hmi.config import SessionConfig
from hmi.log_in import COOKIE, MAX_BODY, add_log_in
from hmi.security import LOOPBACK, RequestChecks

PASSWORD = "correct horse"
OWN = "http://127.0.0.1:8680"
FORM = {"name": "anna", "password": PASSWORD}


@pytest.fixture
def access(tmp_path: Path) -> Access:
    add_user(tmp_path / "users.yaml", "anna", "operate", PASSWORD)
    config = SessionConfig(idle_s=100.0, max_s=1000.0, attempts=3, attempts_s=60.0, seat_s=15.0)
    return Access(config, read_users(tmp_path / "users.yaml"))


@pytest.fixture
def client(access: Access) -> TestClient:
    app = FastAPI()
    add_log_in(app, access, "http://127.0.0.1:8681/")

    @app.websocket("/socket")
    async def socket(link: WebSocket) -> None:
        await link.accept()
        await link.send_text("open")

    app.add_middleware(RequestChecks, hosts=LOOPBACK, frames=["http://127.0.0.1:8681/"])
    return TestClient(app, base_url=OWN, follow_redirects=False)


def test_log_in_sets_a_cookie_for_this_site_and_not_for_scripts(client: TestClient) -> None:
    answer = client.post("/log-in", data=FORM, headers={"Origin": OWN})
    assert answer.status_code == 303
    cookie = answer.headers["set-cookie"].lower()
    assert cookie.startswith(COOKIE)
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert PASSWORD not in cookie


def test_wrong_password_then_locked(client: TestClient) -> None:
    wrong = FORM | {"password": "wrong"}
    codes = [client.post("/log-in", data=wrong, headers={"Origin": OWN}).status_code for _ in range(4)]
    assert codes == [401, 401, 401, 429]
    assert client.post("/log-in", data=FORM, headers={"Origin": OWN}).status_code == 429


@pytest.mark.parametrize("origin", ["http://example.org", "http://127.0.0.1:8681", "https://127.0.0.1:9", "null"])
def test_post_from_another_page_is_refused(client: TestClient, access: Access, origin: str) -> None:
    assert client.post("/log-in", data=FORM, headers={"Origin": origin}).status_code == 403
    assert access._sessions == {}


@pytest.mark.parametrize("host", ["example.org", "127.0.0.1.example.org:8680", "", "[::1]:8680"])
def test_request_for_another_host_is_refused(client: TestClient, host: str) -> None:
    """DNS rebinding: a foreign name that resolves to this computer."""
    assert client.get("/log-in", headers={"Host": host}).status_code == 403


def test_websocket_from_another_page_is_refused(client: TestClient) -> None:
    with client.websocket_connect("/socket", headers={"Origin": OWN, "Host": "127.0.0.1:8680"}) as link:
        assert link.receive_text() == "open"
    for headers in ({"Origin": "http://example.org", "Host": "127.0.0.1:8680"}, {"Origin": OWN, "Host": "example.org"}):
        with pytest.raises(WebSocketDisconnect), client.websocket_connect("/socket", headers=headers):
            pass


def test_pages_may_load_from_this_server_alone(client: TestClient) -> None:
    policy = client.get("/log-in").headers["content-security-policy"]
    assert "default-src 'self'" in policy
    assert "frame-src http://127.0.0.1:8681/" in policy
    assert "frame-ancestors 'none'" in policy


def test_log_out_ends_the_session(client: TestClient, access: Access) -> None:
    client.post("/log-in", data=FORM, headers={"Origin": OWN})
    assert len(access._sessions) == 1
    client.post("/log-out", headers={"Origin": OWN})
    assert access._sessions == {}


@pytest.mark.parametrize("body", [b"", b"name", b"name=%FF&password=%00", b"\xff\xfe", b"a" * (MAX_BODY + 1)])
def test_odd_bodies_open_no_session(client: TestClient, access: Access, body: bytes) -> None:
    assert client.post("/log-in", content=body, headers={"Origin": OWN}).status_code == 401
    assert access._sessions == {}


def test_text_of_a_request_is_not_put_into_the_page(client: TestClient) -> None:
    answer = client.get("/log-in", params={"lang": "<script>alert(1)</script>"})
    assert "<script" not in answer.text
    assert 'lang="en"' in answer.text
