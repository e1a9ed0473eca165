"""Log-in as a plain HTML form, without scripts."""

import asyncio
import time
from html import escape
from urllib.parse import parse_qs

from fastapi import FastAPI, Request, Response
from fastapi.responses import HTMLResponse, RedirectResponse

from hmi.access import Access, Session
from hmi.texts import Texts, texts_of

COOKIE = "headland_session"
MAX_BODY = 4096

FORM = """<!DOCTYPE html>
<html lang="{lang}"><head><meta charset="utf-8"><title>{title}</title>
<meta name="viewport" content="width=device-width, initial-scale=1"><link rel="stylesheet" href="/static/page.css">
</head><body class="hl-log-in"><main><h1>{title}</h1>
<form method="post" action="/log-in?lang={lang}">
<label>{name}<input name="name" autocomplete="username" required autofocus maxlength="60"></label>
<label>{password}<input name="password" type="password" autocomplete="current-password" required></label>
<p role="alert">{error}</p><button class="hl-primary" type="submit">{enter}</button></form>
<p>{note}</p><p><a href="/log-in?lang={other}">{language}</a></p></main>{stop}</body></html>
"""


def language_of(request: Request) -> str:
    """Language of a request: chosen in the address, else the first one that the browser prefers."""
    chosen = request.query_params.get("lang")
    return chosen or ("zh" if request.headers.get("accept-language", "").lower().startswith("zh") else "en")


def session_of(request: Request, access: Access) -> Session | None:
    """Session of the request's cookie."""
    return access.session(request.cookies.get(COOKIE), time.monotonic())


def stop_frame(stop_url: str | None, texts: Texts) -> str:
    """Frame with the emergency stop, nothing without a machine."""
    if stop_url is None:
        return ""
    title = escape(texts("stop.title"))
    return f'<iframe class="hl-stop" title="{title}" src="{stop_url}?lang={texts.language}"></iframe>'


def add_log_in(app: FastAPI, access: Access, stop_url: str | None, is_secure: bool = False) -> None:
    """Adds the routes of log-in and log-out; the cookie of an HTTPS page is never sent by HTTP."""

    def form(request: Request, error: str, code: int) -> Response:
        texts = texts_of(language_of(request))
        words = {key: escape(texts(f"log_in.{key}")) for key in ("title", "name", "password", "enter", "note")}
        other = "en" if texts.language == "zh" else "zh"
        page = FORM.format(
            lang=texts.language, other=other, language=escape(texts("page.language")), stop=stop_frame(stop_url, texts),
            error=escape(texts(error)) if error else "", **words,
        )  # fmt: skip
        return HTMLResponse(page, code, {"Cache-Control": "no-store"})

    @app.get("/log-in")
    async def show(request: Request) -> Response:
        return form(request, "", 200)

    @app.post("/log-in")
    async def enter(request: Request) -> Response:
        now_s = time.monotonic()
        if access.is_locked(now_s):
            return form(request, "log_in.too_many", 429)
        name, password = await _credentials(request)
        token = await asyncio.to_thread(access.log_in, name, password, now_s)
        if token is None:
            return form(request, "log_in.wrong", 401)
        answer = RedirectResponse(f"/?lang={texts_of(language_of(request)).language}", 303)
        answer.set_cookie(
            COOKIE, token, httponly=True, secure=is_secure, samesite="strict", max_age=round(access.config.max_s)
        )
        return answer

    @app.post("/log-out")
    async def leave(request: Request) -> Response:
        access.log_out(request.cookies.get(COOKIE))
        answer = RedirectResponse(f"/log-in?lang={texts_of(language_of(request)).language}", 303)
        answer.delete_cookie(COOKIE)
        return answer


async def _credentials(request: Request) -> tuple[str, str]:
    """Name and password of the form, empty if there are none."""
    body = b""
    async for chunk in request.stream():
        body += chunk
        if len(body) > MAX_BODY:
            return "", ""
    values = parse_qs(body.decode(errors="replace"))
    return values.get("name", [""])[0], values.get("password", [""])[0]
