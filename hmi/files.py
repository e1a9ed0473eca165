"""Files to and from the browser: field files of the plan view, logs and reports of runs, and the statistics."""

import asyncio
import os
import time
from collections.abc import AsyncGenerator, Iterator
from pathlib import Path

from fastapi import FastAPI, Request, Response
from fastapi.responses import PlainTextResponse, StreamingResponse
from starlette.datastructures import UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser
from starlette.requests import ClientDisconnect

from hmi.access import OPERATORS, Session
from hmi.diagnosis.run_files import file_of
from hmi.log_in import language_of, session_of
from hmi.parts import PageParts
from hmi.plan_view.desk import MAX_FIELD_BYTES, MAX_FILES
from hmi.refusal import Refused
from hmi.statistics.store import to_csv
from hmi.texts import texts_of
from messages.errors import HeadlandError

RECEIVE_S = 60.0  # for a field file to arrive
CHUNK_BYTES = 1 << 18
FORM_BYTES = 100_000  # of a form beside its files


def add_files(app: FastAPI, parts: PageParts) -> None:
    """Adds the routes; all need a session, and the field file the seat of the operator, one at a time."""
    receiving = asyncio.Lock()

    @app.post("/plan/field")
    async def take_field(request: Request) -> Response:
        texts = texts_of(language_of(request))
        session = session_of(request, parts.access)
        if session is None:
            return PlainTextResponse(texts("refused.session"), 401)
        session.used_s = time.monotonic()
        try:
            _check_seat(session, parts)
            if receiving.locked():
                raise Refused("receiving")
            async with receiving, asyncio.timeout(RECEIVE_S):
                files = await _files(request)
            _check_seat(session, parts)
            await parts.desk.load(files)
        except _NoSeat:
            return PlainTextResponse(texts("why.not_seated"), 403)
        except (TimeoutError, ClientDisconnect):
            return PlainTextResponse(texts("refused.upload_failed"), 408)
        except Refused as refused:
            code = 413 if refused.key == "too_large" else 400
            return PlainTextResponse(texts(f"refused.{refused.key}", **refused.values), code)
        except HeadlandError as error:
            return PlainTextResponse(str(error), 500)
        return Response(status_code=204)

    @app.get("/runs/{run}/{name}")
    async def give_file(request: Request, run: str, name: str) -> Response:
        texts = texts_of(language_of(request))
        if session_of(request, parts.access) is None:
            return PlainTextResponse(texts("refused.session"), 401)
        path = file_of(parts.runs, run, name)
        if path is None:
            return PlainTextResponse(texts("refused.no_file"), 404)
        size = path.stat().st_size  # a log grows while it is sent
        headers = {
            "Content-Disposition": f'attachment; filename="{run}-{name}"', "Content-Length": str(size),
            "Cache-Control": "no-store",
        }  # fmt: skip
        return StreamingResponse(_beginning(path, size), media_type="application/octet-stream", headers=headers)

    @app.get("/statistics.csv")
    async def give_statistics(request: Request) -> Response:
        if session_of(request, parts.access) is None:
            return PlainTextResponse(texts_of(language_of(request))("refused.session"), 401)
        named = {"Content-Disposition": 'attachment; filename="headland-statistics.csv"', "Cache-Control": "no-store"}
        return Response(to_csv(parts.days()), media_type="text/csv", headers=named)


class _NoSeat(HeadlandError):
    """The session has no control."""


def _check_seat(session: Session, parts: PageParts) -> None:
    if session.role not in OPERATORS or parts.access.seated(time.monotonic()) is not session:
        raise _NoSeat


def _beginning(path: Path, size: int) -> Iterator[bytes]:
    """The first `size` bytes of a file."""
    with os.fdopen(os.open(path, os.O_RDONLY | os.O_NOFOLLOW), "rb") as file:
        while size > 0 and (chunk := file.read(min(size, CHUNK_BYTES))):
            size -= len(chunk)
            yield chunk


async def _files(request: Request) -> dict[str, bytes]:
    """Files of a form, at most `MAX_FIELD_BYTES` together; raises Refused."""
    length = request.headers.get("content-length", "0")
    if not length.isdecimal() or len(length) > 12 or int(length) > MAX_FIELD_BYTES + FORM_BYTES:
        raise Refused("too_large")
    if not request.headers.get("content-type", "").startswith("multipart/form-data"):
        raise Refused("no_file")

    async def limited() -> AsyncGenerator[bytes, None]:
        received = 0
        async for chunk in request.stream():
            received += len(chunk)
            if received > MAX_FIELD_BYTES + FORM_BYTES:
                raise Refused("too_large")
            yield chunk

    parser = MultiPartParser(request.headers, limited(), max_files=MAX_FILES, max_fields=0)
    try:
        form = await parser.parse()
    except (MultiPartException, KeyError, ValueError) as error:
        raise Refused("no_file") from error
    sent = [part for _, part in form.multi_items() if isinstance(part, UploadFile)]
    files = {part.filename or "": await part.read() for part in sent}
    await form.close()
    if len(files) < len(sent):
        raise Refused("same_name")
    return files
