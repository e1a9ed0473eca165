"""What leaves the page of a machine in Chromium: a mail to who is elsewhere, totals and alarms to a platform."""

from collections.abc import Iterator
from email import message_from_string
from pathlib import Path
from typing import Any

import pytest
import yaml

from configs.strict import CONFIGS
from tests.hmi.browser import Browser, add_user, log_in, needs_browser, page_process, view, wait_for
from tests.hmi.mail_server import mail_server
from tests.hmi.receiver import Receiver, receiver

pytestmark = [needs_browser, pytest.mark.slow, pytest.mark.drive]
PASSWORD = "correct horse"
MANY = 1_000_000


class Farm:
    """A page with its mail server and its platform, which at first cuts every request."""

    def __init__(self, page: Any, mails: Any, platform: Receiver) -> None:
        self.page, self.mails, self.platform = page, mails, platform


@pytest.fixture(scope="module")
def farm(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Farm]:
    folder = tmp_path_factory.mktemp("page")
    add_user(folder, "kim:service", PASSWORD)
    with mail_server() as server, receiver(folder / "platform.db") as platform:
        platform.cuts = MANY
        config = yaml.safe_load((CONFIGS / "page.yaml").read_text(encoding="utf-8"))
        config["notification"] |= {
            "after_s": 1.0,
            "email": {
                "host": "127.0.0.1", "port": server.server_address[1], "security": "none",
                "sender": "farm@example.org", "recipients": ["anna@example.org"],
            },
        }  # fmt: skip
        config["upload"] |= {"url": platform.url, "every_s": 1.0, "pause_s": 0.2, "max_pause_s": 1.0, "timeout_s": 2.0}
        (folder / "page.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")
        given = ("--mission", "line", "--scenario", "empty", "--stop-port", "0", "--config", str(folder / "page.yaml"))
        with page_process(Path(folder), *given) as process:
            page = browser.open()
            log_in(page, process, "kim", PASSWORD)
            page.wait_for_selector("#rows-position dd")
            yield Farm(page, server.mails, platform)


def test_a_person_elsewhere_is_called_when_the_machine_stands(farm: Farm) -> None:
    """T14-5.5: after an emergency stop a mail says mode, cause and what to do."""
    assert farm.mails.empty()
    farm.page.frame_locator("iframe.hl-stop").locator("#emergency-stop").click()
    wait_for(farm.page, "#mode", "Emergency stop")
    mail = message_from_string(farm.mails.get(timeout=30.0))
    assert mail["To"] == "anna@example.org"
    text = mail.get_payload(decode=True).decode()
    assert "Emergency stop" in text
    assert wait_for(farm.page, "#cause", ".") in text


def test_what_waits_for_the_platform_is_shown_until_it_is_taken(farm: Farm) -> None:
    """T14-5.5: the statistics view says that nothing arrives; later totals and the alarm are there, each once."""
    view(farm.page, "statistics")
    wait_for(farm.page, "#answer", "Not uploaded yet")
    farm.platform.cuts = 0
    wait_for(farm.page, "#answer", "^$")
    farm.page.wait_for_timeout(2000.0)
    alarms = [one["code"] for one in farm.platform.bodies("alarm")]
    assert alarms.count("operator_command.emergency_stop") == 1
    assert farm.platform.bodies("totals")
