"""Scripts of a device: statements separated by `;` or by a new line, comments from `#` on."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Iterator, List, Mapping, Optional, Protocol, Sequence, Tuple

from .errors import DeviceError, syntax
from .words import ScriptWord, Words, read_whole, split

MAX_BYTES = 64 * 1024
"""The longest script, in bytes."""
MAX_STATEMENTS = 1000
"""The most statements of a script."""
MAX_ATTACHED = 8 << 20
"""The most bytes that came with the scripts of one device that wait and are carried out."""
MAX_WAIT = 60_000
"""The longest `wait`, in ms."""
WAIT = "wait"


class Attachments:
    """Bytes that come with a script, by the names that its statements use."""

    def __init__(self, content: Optional[Mapping[str, Any]] = None) -> None:
        self._bytes: Mapping[str, bytes] = content or {}
        for name, value in self._bytes.items():
            if not isinstance(value, bytes):
                raise DeviceError("syntax", f"the attachment `{name}` must be bytes")

    @property
    def size(self) -> int:
        """How many bytes they have."""
        return sum(map(len, self._bytes.values()))

    def get(self, name: str) -> bytes:
        """The bytes of this name; `syntax` with the names that there are."""
        if name in self._bytes:
            return self._bytes[name]
        names = ", ".join(sorted(self._bytes))
        there = f", but {names}" if names else ": it has no attachments"
        raise DeviceError("syntax", f"`{name}` did not come with the script{there}")


@dataclass(frozen=True)
class Wait:
    """`wait ms`: nothing is begun for so many ms, 0 to `MAX_WAIT`."""

    ms: int


@dataclass(frozen=True)
class Script:
    """A script: between 1 and `MAX_STATEMENTS` statements, each an action of the machine or a `Wait`."""

    statements: List[Any]
    attached: int = field(default=0)
    """How many bytes came with it."""

    def actions(self) -> Iterator[Tuple[Any, int]]:
        """What the device does, with the number of each statement (1 for the first)."""
        return ((one, number) for number, one in enumerate(self.statements, 1) if not isinstance(one, Wait))


class Language(Protocol):
    """What reading a script needs of a machine."""

    @property
    def verbs(self) -> Sequence[str]:
        """The first words of its statements."""

    def read(self, verb: ScriptWord, words: Words) -> Any:
        """Reads what follows a verb."""

    def attach(self, action: Any, attachments: Attachments) -> None:
        """Gives an action its bytes."""


def read_script(machine: Language, text: str, attachments: Attachments) -> Script:
    """Reads a script of a machine; raises `syntax` with the statement, the place, and the nearest known word to an unknown one."""
    try:
        script = Script(_statements(machine, text), attachments.size)
    except DeviceError as error:
        raise error.in_text(text)
    for action, number in script.actions():
        try:
            machine.attach(action, attachments)
        except DeviceError as error:
            raise error.at_statement(number)
    return script


def _statements(machine: Language, text: str) -> List[Any]:
    size = len(text.encode("utf-8", "surrogatepass"))
    if size > MAX_BYTES:
        raise syntax(MAX_BYTES, f"the script has {size} bytes, at most {MAX_BYTES} are read")
    statements: List[Any] = []
    for words in split(text):
        verb = words.next()
        if verb is None:
            continue
        if len(statements) == MAX_STATEMENTS:
            raise syntax(verb.at, f"the script has more than {MAX_STATEMENTS} statements")
        try:
            statements.append(_statement(machine, verb, words))
        except DeviceError as error:
            raise error.at_statement(len(statements) + 1)
    if not statements:
        raise syntax(0, "the script has no statement")
    return statements


def _statement(machine: Language, verb: ScriptWord, words: Words) -> Any:
    if verb.text == WAIT:
        statement = _wait(words)
    else:
        statement = machine.read(verb, words)
        if statement is None:
            nearest = verb.nearest([*machine.verbs, WAIT])
            text = f"there is no `{verb.short}`; did you mean `{nearest}`?"
            raise syntax(verb.at, text).with_nearest(nearest)
    more = words.next()
    if more is not None:
        text = f"`{verb.text}` ends before `{more.short}`; is a `;` or a new line missing?"
        raise syntax(more.at, text)
    return statement


def _wait(words: Words) -> Wait:
    word = words.need(WAIT, "a time in ms", "it")
    ms = read_whole(word.text)
    if ms is None or not 0 <= ms <= MAX_WAIT:
        text = f"`wait` takes a whole number of ms from 0 to {MAX_WAIT}, not `{word.short}`"
        raise syntax(word.at, text)
    return Wait(ms)
