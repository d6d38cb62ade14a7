"""Errors of devices: the words and numbers of docs/PROTOCOL.md, in plain words beside them."""

from __future__ import annotations

import logging
from typing import Any, Dict, Optional

from ..values import pack, sayable

LOG = logging.getLogger("mom")

ERRORS: Dict[str, int] = {
    "syntax": 5001, "workspace-boundary": 5002, "link": 5003, "singularity": 5004, "joint-limit": 5005,
    "torque-overload": 5006,
    "halted": 5101, "stopped": 5102, "queue-full": 5103, "duplicate-id": 5104, "changing-hands": 5105, "busy": 5106,
    "too-old": 5107, "no-state": 5108, "zone-not-owned": 5109, "obstacle": 5110, "battery": 5111,
    "estop": 5112,
}  # fmt: skip
"""The words of errors and their numbers, as all devices of MOM have them."""

_RETRYABLE = ("queue-full", "busy")


class DeviceError(Exception):
    """Why a device does not carry out a command, or ends it: raise it in a verb or in `plan`.

    `name` is a word of `ERRORS`, such as `obstacle`; `text` are plain words. On the wire it is a map of `name`, `code`, `text` and,
    where they apply, `retry`, `statement`, `position`, `line`, `column`, `nearest`, `late` and `reachable`.
    """

    def __init__(self, name: str, text: str, *, reachable: Any = None) -> None:
        super().__init__(name, text)
        if name not in ERRORS:
            raise ValueError(f"there is no error `{name}` of devices: see mom.device.ERRORS")
        self.name = name
        """The word, such as `syntax`."""
        self.number = ERRORS[name]
        """Its number, such as 5001: `code` on the wire."""
        self.text = text
        """Plain words, with the statement's number in front where there is one."""
        self.retry = name in _RETRYABLE
        """Whether the same command may be taken a little later, although nothing about it changes."""
        self.statement: Optional[int] = None
        """The statement concerned, 1 for the first."""
        self.position: Optional[int] = None
        """The byte of the script at which the mistake begins, from 0."""
        self.line: Optional[int] = None
        """Its line, 1 for the first."""
        self.column: Optional[int] = None
        """Its character in that line, 1 for the first."""
        self.nearest: Optional[str] = None
        """The known word that was probably meant."""
        self.late: Optional[int] = None
        """ms since the device had come to rest, as its program had stood still."""
        self.reachable = reachable
        """The nearest position that the device can reach, a map."""

    def __str__(self) -> str:
        return self.text

    def with_retry(self) -> DeviceError:
        """The same error, where the same command may be taken a little later."""
        self.retry = True
        return self

    def with_nearest(self, nearest: str) -> DeviceError:
        """The same error, with the word that was probably meant."""
        self.nearest = nearest or None
        return self

    def at_statement(self, statement: int) -> DeviceError:
        """The same error, said of a statement (1 for the first)."""
        self.text = f"statement {statement}: {self.text}"
        self.statement = statement
        return self

    def in_text(self, script: str) -> DeviceError:
        """The same error, with the line and the column of its position in this script."""
        if self.position is not None:
            before = script.encode("utf-8", "surrogatepass")[: self.position].decode("utf-8", "ignore")
            self.line = before.count("\n") + 1
            self.column = len(before.rsplit("\n", 1)[-1]) + 1
        return self

    def content(self) -> Dict[str, Any]:
        """The key `error` of a `status`."""
        content: Dict[str, Any] = {"name": self.name, "code": self.number, "text": sayable(self.text)}
        if self.retry:
            content["retry"] = True
        for key in ("statement", "position", "line", "column", "nearest", "late", "reachable"):
            value = getattr(self, key)
            if value is not None and _can_be_said(key, value):
                content[key] = value
        return content


def _can_be_said(key: str, value: Any) -> bool:
    """Whether it can be sent: its sender has to hear of the error without it otherwise."""
    try:
        pack({key: value})
    except Exception as error:
        LOG.warning("`%s` of an error of a device is left out: %s", key, error)
        return False
    return True


def syntax(position: int, text: str) -> DeviceError:
    """A mistake in a script, at this byte."""
    error = DeviceError("syntax", text)
    error.position = position
    return error
