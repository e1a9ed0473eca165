"""Formats that are recognized and not read, so that a refusal names them."""

import binascii
import re

from datasets.importers.gnss.framing import RTCM, frames

# Identifiers of SuperStar II are followed by their complement.
_SUPERSTAR = b"|".join(re.escape(bytes((1, value, 255 - value))) for value in range(1, 128))
_ABBREVIATED = rb"(?m)^<[A-Z][A-Z0-9]+ [A-Z0-9]+ \d+ \d+\.\d+ [A-Z]+ \d+ |<OK\s+\[\w{3,}\]"
# Of a receiver that answers with it and sends something else, that is named.
NOVATEL_TEXT = "a NovAtel abbreviated ASCII stream"
# Name, pattern, number of times that it must occur in the first bytes
_PATTERNS: tuple[tuple[str, bytes, int], ...] = (
    ("a zip file (unpack it first)", rb"\APK\x03\x04", 1),
    ("UTF-16 text (save it as ASCII)", rb"\A(?:\xff\xfe|\xfe\xff)", 1),
    ("an NTRIP session", rb"\A(?:ICY 200 OK|SOURCETABLE 200|HTTP/1\.[01] 200)", 1),
    ("a NovAtel binary stream", rb"\xaa\x44[\x12\x13]", 1),
    ("a Unicore binary stream", rb"\xaa\x44\xb5", 1),
    ("a NovAtel or Unicore ASCII stream", rb"(?m)^[#%][A-Z][A-Z0-9_]+,[^\r\n;]{5,200};", 1),
    ("an RTCM 2 stream", rb"[\x40-\x7f]{200,}", 1),
    ("an RTCM 2 stream", rb"[\x40-\x7f]{60,}", 3),  # one message a line
    (NOVATEL_TEXT, _ABBREVIATED, 1),
    ("a SiRF binary stream", rb"\xa0\xa2[\x00-\x07].{1,2049}?\xb0\xb3", 2),
    ("a SkyTraq binary stream", rb"\xa0\xa1[\x00-\x0f].{3,1030}?\r\n", 2),
    ("a Motorola Oncore stream", rb"@@[A-Z][a-z].{2,290}?\r\n", 2),
    ("a Rockwell Zodiac stream", rb"\xff\x81.[\x03\x04]", 2),
    ("a Trimble TSIP stream", rb"\x10[\x40-\x8f](?:[^\x10]|\x10\x10){1,300}\x10\x03", 3),
    ("a NovAtel SuperStar II stream", _SUPERSTAR, 4),
    ("a Fastrax iTalk stream", rb"<![\x20-\x7f]\x7f", 2),
    ("a SICK compact scan segment", rb"\A\x02\x02\x02\x02\x01\0\0\0", 1),
    ("SICK CoLa telegrams", rb"\A\x02(?:\x02{3}.{4})?s[A-Z]{2} ", 1),
    ("a SICK msgpack scan segment", rb"\A\x82\x10\xcc\x90\x11\x88", 1),
    ("a table of angles of a lidar, used beside its capture", rb"\A(?:Laser id|Channel),Elevation,Azimuth", 1),
    ("a PCAN trace of another version than 1.1, 1.3, 2.0 and 2.1", rb"\A;\$FILEVERSION=", 1),
    ("output of candump without times (record with candump -l)", rb"\A *\w+  [0-9A-F]{3,8}   \[\d\] ", 1),
    ("JSON", rb"\A\s*[\[{]\s*[\"{]", 1),
)
_COMPILED = tuple((name, re.compile(pattern, re.DOTALL), count) for name, pattern, count in _PATTERNS)


def name_of(head: bytes) -> str | None:
    """Name of the format of a file by its first bytes, None for an unknown one."""
    if _is_sbf(head):
        return "a Septentrio SBF stream"
    name = next((name for name, pattern, count in _COMPILED if len(pattern.findall(head)) >= count), None)
    if name in (None, NOVATEL_TEXT) and any(frame.protocol == RTCM for frame in frames(head)):
        return "an RTCM 3 stream"
    return name


def _is_sbf(head: bytes) -> bool:
    """Whether the bytes begin with the sync of SBF, or hold a block with a right checksum."""
    at = head.find(b"$@")
    while at > 0:
        size = int.from_bytes(head[at + 6 : at + 8], "little")
        checksum = int.from_bytes(head[at + 2 : at + 4], "little")
        if 8 <= size <= len(head) - at and binascii.crc_hqx(head[at + 4 : at + size], 0) == checksum:
            return True
        at = head.find(b"$@", at + 1)
    return at == 0
