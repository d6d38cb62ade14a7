"""The words of a script, with their places."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Iterable, Iterator, List, Optional

from .errors import syntax

_LONGEST_WORD = 24
"""The longest part of a wrong word that an error repeats, in characters."""
_MOST_COMPARED = 128
_LONGEST_COMPARED = 64

_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_WHOLE = re.compile(r"[+-]?[0-9]{1,18}")
_WORD = re.compile(r"\S+")


@dataclass(frozen=True)
class ScriptWord:
    """A word and the byte at which it begins."""

    text: str
    at: int

    @property
    def short(self) -> str:
        """The word for an error's text, shortened."""
        return self.text if len(self.text) <= _LONGEST_WORD else self.text[:_LONGEST_WORD] + "…"

    def nearest(self, known: Iterable[str]) -> str:
        """The most similar of some known words, without regard to case; an empty one of none."""
        return most_similar(self.short.lower(), known)


class Words:
    """The words of one statement that are still to be read."""

    def __init__(self, words: List[ScriptWord], end: int) -> None:
        self._words, self._end = words, end

    @property
    def is_over(self) -> bool:
        """Whether none is left."""
        return not self._words

    def next(self) -> Optional[ScriptWord]:
        """The next word, if there is one."""
        return self._words.pop(0) if self._words else None

    def need(self, verb: str, takes: str, which: str) -> ScriptWord:
        """The next word, which is `which` of what `verb` takes; `syntax` if the statement ends before."""
        word = self.next()
        if word is None:
            raise syntax(self._end, f"`{verb}` takes {takes}; {which} is missing")
        return word


def read_number(text: str) -> Optional[float]:
    """A finite decimal number; `None` if it is something else."""
    number = float(text) if _NUMBER.fullmatch(text) else None
    # What is too large becomes an infinity.
    return None if number is None or abs(number) == float("inf") else number


def read_whole(text: str) -> Optional[int]:
    """A whole number; `None` if it is something else."""
    return int(text) if _WHOLE.fullmatch(text) else None


def split(text: str) -> Iterator[Words]:
    """The statements of a script as words, without their comments; some may have no word."""
    at = 0
    for line in text.split("\n"):
        here = at
        for part in line.split("#", 1)[0].split(";"):
            words = [
                ScriptWord(found.group(), here + _size(part[: found.start()])) for found in _WORD.finditer(part)
            ]
            yield Words(words, here + _size(part))
            here += _size(part) + 1
        at += _size(line) + 1


def _size(text: str) -> int:
    return len(text.encode("utf-8", "surrogatepass"))


def most_similar(word: str, known: Iterable[str]) -> str:
    """The most similar of some words, however little it is like `word`; an empty one of none."""
    candidates = [one for one in list(known)[:_MOST_COMPARED] if len(one) <= _LONGEST_COMPARED]
    return min(candidates, key=lambda one: _distance(word[:_LONGEST_COMPARED], one), default="")


def _distance(one: str, other: str) -> int:
    """How many letters differ; a swap of two that stand side by side is one change."""
    before: List[int] = []
    row = list(range(len(other) + 1))
    for i, letter in enumerate(one, 1):
        older, before, row = before, row, [i]
        for j, there in enumerate(other, 1):
            cost = min(before[j] + 1, row[j - 1] + 1, before[j - 1] + (letter != there))
            if older and j > 1 and letter == other[j - 2] and one[i - 2] == there:
                cost = min(cost, older[j - 2] + 1)
            row.append(cost)
    return row[-1]


