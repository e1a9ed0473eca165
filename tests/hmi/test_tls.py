"""Page and emergency stop by TLS: the certificate of the first start, and a browser that accepts it."""

import datetime
import socket
import ssl
import subprocess
import sys
import time
from http.client import HTTPSConnection
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from hmi.certificate import CERTIFICATE, KEY, own_certificate
from hmi.emergency_stop import make_server
from messages.errors import HeadlandError
from tests.hmi.browser import Browser, add_user, log_in, needs_browser, page_process, row, wait_for
from tests.recordings import ROOT

ADDRESS = "127.0.0.1"
NOW = datetime.datetime.now(datetime.UTC)
PASSWORD = "correct horse"


def test_a_certificate_is_made_once_and_only_its_owner_reads_the_key(tmp_path: Path) -> None:
    made = own_certificate(tmp_path / "state", "192.168.1.5")
    assert own_certificate(tmp_path / "state", "192.168.1.5").fingerprint == made.fingerprint
    assert (tmp_path / "state" / KEY).stat().st_mode & 0o777 == 0o600
    assert len(made.fingerprint) == 32 * 3 - 1


@pytest.mark.parametrize("change", ["address", "end", "other key", "damage", "no key"])
def test_another_certificate_is_made_where_the_old_one_does_not_serve(tmp_path: Path, change: str) -> None:
    made = own_certificate(tmp_path, "192.168.1.5")
    if change == "other key":
        own_certificate(tmp_path / "other", "192.168.1.5")
        (tmp_path / KEY).write_bytes((tmp_path / "other" / KEY).read_bytes())
    elif change == "damage":
        (tmp_path / CERTIFICATE).write_bytes((tmp_path / CERTIFICATE).read_bytes()[:200])
    elif change == "no key":
        (tmp_path / KEY).unlink()
    now = NOW + datetime.timedelta(days=780 if change == "end" else 0)
    found = own_certificate(tmp_path, "192.168.1.6" if change == "address" else "192.168.1.5", now)
    assert found.fingerprint != made.fingerprint
    found.context()  # certificate and key belong together


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(HeadlandError, match="file"):
        own_certificate(tmp_path / "file", ADDRESS)


def test_a_client_that_never_shakes_hands_holds_up_no_stop(tmp_path: Path) -> None:
    certificate = own_certificate(tmp_path, ADDRESS)
    server = make_server(ADDRESS, 0, certificate.context())
    silent = [socket.create_connection(server.server_address[:2]) for _ in range(3)]
    began_s = time.monotonic()
    for _ in silent:
        server.handle_request()
    assert time.monotonic() - began_s < 2.0
    for link in silent:
        link.close()
    server.server_close()


@pytest.mark.parametrize("text", ["0.0.0.0", "::1", "example.org", "300.1.1.1", "224.0.0.1"])
def test_an_address_that_is_not_one_of_an_interface_is_refused(text: str) -> None:
    command = [sys.executable, "-m", "runtime", "page", "--listen", text]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert f"--listen {text}: not the IPv4 address of one interface" in done.stderr


@needs_browser
@pytest.mark.slow
@pytest.mark.drive
def test_the_page_works_by_tls(browser: Browser, tmp_path: Path) -> None:
    add_user(tmp_path, "anna:operate", PASSWORD)
    arguments = ("--mission", "line", "--scenario", "empty", "--stop-port", "0", "--listen", ADDRESS)
    with page_process(tmp_path, *arguments) as process:
        assert process.url.startswith("https://")
        assert process.stop_url.startswith("https://")
        trusted = ssl.create_default_context(cafile=str(tmp_path / "state" / CERTIFICATE))
        for url in (process.url, process.stop_url):
            link = HTTPSConnection(urlsplit(url).netloc, context=trusted, timeout=10.0)
            link.request("GET", "/log-in")
            assert link.getresponse().status == 200
            with pytest.raises(ssl.SSLCertVerificationError):
                HTTPSConnection(urlsplit(url).netloc, context=ssl.create_default_context()).request("GET", "/")
        with socket.create_connection((ADDRESS, urlsplit(process.url).port or 0)) as plain:
            plain.sendall(b"GET /log-in HTTP/1.0\r\n\r\n")
            assert b"200" not in plain.recv(100)
        page = browser.open(trusts_all=True)
        log_in(page, process, "anna", PASSWORD)
        wait_for(page, "#mode", "Standby")
        assert row(page, "machine", "park_brake") == "set"
        assert [one["secure"] for one in page.context.cookies() if one["name"] == "headland_session"] == [True]
        page.frame_locator("iframe.hl-stop").locator("#emergency-stop").click()
        wait_for(page, "#mode", "Emergency stop")
        page.context.close()
