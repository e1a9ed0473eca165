"""Users with argon2 hashes, sessions, and the seat of the one operator."""

import hashlib
import os
import secrets
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import yaml
from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError
from pydantic import Field

from configs.strict import Config, load
from hmi.config import SessionConfig
from messages.errors import HeadlandError

Role = Literal["view", "operate", "setup", "service"]
ROLES: tuple[Role, ...] = ("view", "operate", "setup", "service")
OPERATORS = ("operate", "setup", "service")  # roles that may have control
SETTERS = ("setup", "service")  # that change the setup of the machine and calibrate it
SERVICE = "service"  # sees the frames of the bus too
MIN_PASSWORD = 8
HASHER = PasswordHasher()
UNKNOWN = HASHER.hash(secrets.token_hex(16))  # of unknown names: an answer takes as long as for known ones


class User(Config):
    """Role and argon2id hash of the password of a user."""

    role: Role
    password_hash: str = Field(pattern=r"^\$argon2id\$", max_length=300)


class Users(Config):
    """File `state/page/users.yaml`: users by name."""

    users: dict[str, User]


@dataclass
class Session:
    """A log-in; `token` is in the cookie of the browser, `pages` counts its open pages."""

    name: str
    role: Role
    opened_s: float
    used_s: float
    pages: int = 0
    left_s: float = 0.0


@dataclass
class Access:
    """Log-in, sessions and seat; times are those of a monotonic clock (s)."""

    config: SessionConfig
    users: dict[str, User]
    holder: Session | None = None
    _sessions: dict[str, Session] = field(default_factory=dict)
    _failed_s: deque[float] = field(default_factory=deque)

    def is_locked(self, now_s: float) -> bool:
        """Whether too many wrong passwords were given lately."""
        while self._failed_s and now_s - self._failed_s[0] > self.config.attempts_s:
            self._failed_s.popleft()
        return len(self._failed_s) >= self.config.attempts

    def log_in(self, name: str, password: str, now_s: float) -> str | None:
        """Token of a new session, None for a wrong name or password; takes about 50 ms."""
        user = self.users.get(name)
        try:
            HASHER.verify(user.password_hash if user else UNKNOWN, password)
        except (VerificationError, InvalidHashError):
            user = None
        if user is None:
            self._failed_s.append(now_s)
            return None
        token = secrets.token_urlsafe(32)
        self._sessions[_digest(token)] = Session(name, user.role, now_s, now_s)
        return token

    def session(self, token: str | None, now_s: float) -> Session | None:
        """Session of a token, None for an unknown or expired one."""
        found = self._sessions.get(_digest(token or ""))
        if found is None:
            return None
        is_idle, is_old = now_s - found.used_s > self.config.idle_s, now_s - found.opened_s > self.config.max_s
        if is_idle or is_old:
            self.log_out(token)
            return None
        return found

    def log_out(self, token: str | None) -> None:
        """Ends a session; its seat is free then."""
        ended = self._sessions.pop(_digest(token or ""), None)
        if ended is not None and self.holder is ended:
            self.holder = None

    def seated(self, now_s: float) -> Session | None:
        """Holder of the seat; it is free when his session has ended or he has had no page for a time."""
        holder = self.holder
        if holder is None:
            return None
        is_away = holder.pages == 0 and now_s - holder.left_s > self.config.seat_s
        is_ended = all(session is not holder for session in self._sessions.values())
        if is_away or is_ended or now_s - holder.used_s > self.config.idle_s:
            self.holder = None
        return self.holder

    def take_seat(self, session: Session, now_s: float) -> bool:
        """Takes a free seat for an operator; whether he holds it now."""
        if session.role in OPERATORS and self.seated(now_s) is None:
            self.holder = session
        return self.holder is session

    def release_seat(self, session: Session) -> None:
        """Frees the seat of this session."""
        if self.holder is session:
            self.holder = None


def read_users(path: Path) -> dict[str, User]:
    """Users of a file, none without one; raises ConfigError."""
    return dict(load(Users, path).users) if path.exists() else {}


def add_user(path: Path, name: str, role: Role, password: str) -> None:
    """Adds or replaces a user; raises HeadlandError. The file can be read by its owner only."""
    if len(password) < MIN_PASSWORD:
        raise HeadlandError(f"the password of {name} has fewer than {MIN_PASSWORD} characters")
    users = read_users(path) | {name: User(role=role, password_hash=HASHER.hash(password))}
    text = yaml.safe_dump({"users": {key: user.model_dump() for key, user in users.items()}})
    fresh = path.with_suffix(".new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        fresh.unlink(missing_ok=True)
        with os.fdopen(os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
            file.write(text)
        fresh.replace(path)
    except OSError as error:
        raise HeadlandError(f"{path}: cannot be written ({error.strerror})") from error


def one_time_user(password: str) -> dict[str, User]:
    """The operator of a start without users."""
    return {"operator": User(role="setup", password_hash=HASHER.hash(password))}


def _digest(token: str) -> str:
    return hashlib.sha256(token.encode()).hexdigest()
