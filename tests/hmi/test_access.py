"""Users, sessions, wrong passwords and the seat of the operator."""

import stat
from pathlib import Path

import pytest

from hmi.access import Access, add_user, one_time_user, read_users
from hmi.config import SessionConfig
from messages.errors import HeadlandError

CONFIG = SessionConfig(idle_s=100.0, max_s=1000.0, attempts=3, attempts_s=60.0, seat_s=15.0)
PASSWORD = "correct horse"


@pytest.fixture
def access(tmp_path: Path) -> Access:
    path = tmp_path / "state" / "users.yaml"
    add_user(path, "anna", "operate", PASSWORD)
    add_user(path, "bo", "operate", PASSWORD)
    add_user(path, "cem", "view", PASSWORD)
    return Access(CONFIG, read_users(path))


def test_user_file_has_hashes_and_is_for_its_owner_alone(tmp_path: Path) -> None:
    path = tmp_path / "users.yaml"
    add_user(path, "anna", "view", PASSWORD)
    add_user(path, "anna", "operate", PASSWORD + "!")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert PASSWORD not in path.read_text()
    assert read_users(path)["anna"].role == "operate"
    access = Access(CONFIG, read_users(path))
    assert access.log_in("anna", PASSWORD, 0.0) is None
    assert access.log_in("anna", PASSWORD + "!", 0.0) is not None


def test_short_password_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    with pytest.raises(HeadlandError, match="fewer than 8"):
        add_user(tmp_path / "users.yaml", "anna", "view", "1234567")
    assert list(tmp_path.iterdir()) == []


def test_wrong_name_or_password_opens_no_session(access: Access) -> None:
    assert access.log_in("anna", "wrong", 0.0) is None
    assert access.log_in("nobody", PASSWORD, 0.0) is None
    assert access.session(None, 0.0) is None
    assert access.session("guess", 0.0) is None


def test_too_many_wrong_passwords_lock_the_log_in_for_a_time(access: Access) -> None:
    for now_s in (0.0, 1.0, 2.0):
        assert not access.is_locked(now_s)
        access.log_in("anna", "wrong", now_s)
    assert access.is_locked(2.0)
    assert access.is_locked(60.0)
    assert not access.is_locked(60.1)


def test_session_expires_without_action_and_after_its_longest_time(access: Access) -> None:
    token = access.log_in("anna", PASSWORD, 0.0)
    session = access.session(token, 100.0)
    assert session is not None
    assert access.session(token, 100.1) is None
    assert access.session(token, 0.0) is None  # it does not come back
    token = access.log_in("anna", PASSWORD, 0.0)
    for now_s in range(0, 1001, 50):
        session = access.session(token, float(now_s))
        assert session is not None
        session.used_s = float(now_s)
    assert access.session(token, 1000.1) is None


def test_tokens_are_not_kept(access: Access) -> None:
    token = access.log_in("anna", PASSWORD, 0.0)
    assert token is not None
    assert token not in repr(access)


def test_one_operator_at_a_time_with_hand_over(access: Access) -> None:
    anna, bo = (access.session(access.log_in(name, PASSWORD, 0.0), 0.0) for name in ("anna", "bo"))
    assert anna is not None
    assert bo is not None
    anna.pages = bo.pages = 1
    assert access.take_seat(anna, 1.0)
    assert not access.take_seat(bo, 2.0)
    access.release_seat(bo)  # not his
    assert access.seated(2.0) is anna
    access.release_seat(anna)
    assert access.take_seat(bo, 3.0)


def test_viewer_gets_no_seat(access: Access) -> None:
    cem = access.session(access.log_in("cem", PASSWORD, 0.0), 0.0)
    assert cem is not None
    assert not access.take_seat(cem, 0.0)
    assert access.seated(0.0) is None


def test_seat_is_free_after_log_out_expiry_and_a_time_without_a_page(access: Access) -> None:
    token = access.log_in("anna", PASSWORD, 0.0)
    anna = access.session(token, 0.0)
    assert anna is not None
    anna.pages = 1
    access.take_seat(anna, 0.0)
    access.log_out(token)
    assert access.seated(0.0) is None
    again = access.session(access.log_in("anna", PASSWORD, 0.0), 0.0)
    assert again is not None
    again.pages = 1
    access.take_seat(again, 0.0)
    assert access.seated(100.0) is again
    assert access.seated(100.1) is None
    again.used_s = 200.0
    again.pages, again.left_s = 0, 200.0
    access.take_seat(again, 200.0)
    assert access.seated(215.0) is again
    assert access.seated(215.1) is None


def test_one_time_user() -> None:
    access = Access(CONFIG, one_time_user(PASSWORD))
    assert access.log_in("operator", PASSWORD, 0.0) is not None
