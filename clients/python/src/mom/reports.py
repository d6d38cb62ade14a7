"""Reports of errors to a hub, by plain HTTP and without a login: they get through where nothing else does (M56)."""

from __future__ import annotations

import asyncio
import json
import logging
import time
from dataclasses import replace
from typing import Dict, Optional

from .address import TUNNEL, Address
from .tunnel import Requests

LOG = logging.getLogger("mom")

_MOST, _WORD = 4096, 64
"""The bytes of a report that a hub takes, and the letters of what is not text in it."""
_PER_MINUTE, _MINUTE = 5, 60.0
"""A hub takes 10 from one address."""
_PATIENCE = 5.0
_HTTP = 80
"""Where a hub may listen for HTTP beside the port of its address."""

_lately: Dict[str, float] = {}
"""What was reported in the last minute, and when."""
_blocked = 0.0
"""The hub takes no more before."""


async def report(
    address: str,
    text: str,
    *,
    level: str = "error",
    code: Optional[str] = None,
    program: Optional[str] = None,
    version: Optional[str] = None,
) -> bool:
    """Reports an error to the hub at an address, where its operators read it by `mom logs`; whether the hub has taken it.

    It needs no login, and goes over the network in the clear, whatever the address says of TLS: at its port, or at that of HTTP if
    nobody answers there. It never fails. `level` is `error`, `warn` or `info`, `code` a word for the error, such as that of a
    `MomError`. A text that is longer than a hub takes is cut. At most 5 reports leave in a minute, and each text once.
    """
    try:
        body = _body(text, {"level": level, "code": code, "program": program, "version": version})
        if not text.strip() or not _is_timely(text):
            return False
        found = Address.parse(address)
        for port in dict.fromkeys([found.port, _HTTP]):
            try:
                return await asyncio.wait_for(_post(replace(found, door=TUNNEL, tls=False, port=port), body), _PATIENCE)
            except (OSError, EOFError, asyncio.TimeoutError) as error:
                LOG.debug("no report can be sent to %s:%d: %r", found.host, port, error)
    except Exception as error:
        # Reporting an error must not raise another one.
        LOG.debug("sending a report failed: %r", error)
    return False


def _body(text: str, words: Dict[str, Optional[str]]) -> bytes:
    report = {key: _letters(word, _WORD) for key, word in words.items() if word is not None}
    letters = _letters(text, _MOST)
    while True:
        body = json.dumps({"text": letters, **report}, ensure_ascii=False).encode()
        over = len(body) - _MOST
        if over <= 0:
            return body
        # No letter is written in more than 6 bytes.
        letters = letters[: -(-(-over // 6))]


def _letters(text: str, most: int) -> str:
    """Halves of letters are none."""
    return text[:most].encode("utf-8", "replace").decode()


def _is_timely(text: str) -> bool:
    """Counts a report, unless it is one too many."""
    now = time.monotonic()
    for said in [said for said, at in _lately.items() if now - at >= _MINUTE]:
        del _lately[said]
    if now < _blocked or len(_lately) >= _PER_MINUTE or text in _lately:
        return False
    _lately[text] = now
    return True


async def _post(address: Address, body: bytes) -> bool:
    global _blocked
    requests = Requests(address, None, None)
    try:
        status, headers = await requests.open("POST", "/log", body)
    finally:
        requests.drop()
    if status == 429:
        wait = headers.get("retry-after", "")
        _blocked = time.monotonic() + (float(wait) if wait.isdecimal() else _PATIENCE)
    return 200 <= status < 300
