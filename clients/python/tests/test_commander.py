"""What becomes of commands: the dialogues of `tests/cases/commander.txt`, which `tests/cases/README.md` explains."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Optional, Tuple

import pytest

import mom
from mom.drive import Command, CommandEnd, CommandFailed, DriveError, Progress, lost_words
from mom.drive.course import NEWEST, Basis, Course, Do, Send, Step
from mom.drive.end import Whose, quoted
from mom.drive.heard import Report, StateNews, visible
from mom.drive.relative import is_relative
from mom.parcel import Parcel

FILE = Path(__file__).parents[3] / "tests/cases/commander.txt"


class Stage:
    """A course of commands to the arm, with a clock that a dialogue moves."""

    def __init__(self) -> None:
        self.course = Course("alice", Whose("/robot/arm", "/robot/token"), 5)
        self.text, self.now = "", 0
        self.says: List[str] = []

    def play(self, lines: List[str]) -> None:
        """Plays lines: those with `>` are what must have been said since the line before."""
        while lines:
            line = lines.pop(0)
            self.act(line)
            expected = [one[2:] for one in itertools.takewhile(lambda one: one.startswith("> "), lines)]
            del lines[: len(expected)]
            says, self.says = self.says, []
            assert fits(says, expected), f"after `{line}`: {says} instead of {expected}"

    def act(self, line: str) -> None:
        """Something happens."""
        head, _, text = line.partition(": ")
        words = line.split(" ")
        self.by = words.pop(0) if words[0] == "other" else "robot"
        if text and head.split(" ")[0] in ("command", "pull"):
            self.begin(head.split(" "), text)
        elif words[1:2] == ["leaves"] or words[1:] == ["is", "lost"]:
            self.course.gone(words[0], missed=words[1] == "is")
        else:
            self.acts[words[0]](self, words[1:])
        self.gather()

    def begin(self, head: List[str], text: str) -> None:
        bases: Dict[str, Callable[[], Basis]] = {"relative": lambda: NEWEST, "on": lambda: int(head[2]), "once": lambda: None}
        basis = bases[head[1]]() if head[1:] else None
        self.text = text
        self.course.begin(text, basis, pulls=head[0] == "pull", once=head[1:] == ["once"])

    def old(self, words: List[str]) -> None:
        # Who feeds a course leaves old reports out.
        if words[0] == "state":
            self.state(words[1:], is_old=True)
        else:
            assert words[0] == "status"

    def state(self, words: List[str], is_old: bool = False) -> None:
        fence = int(words[words.index("under") + 1]) if "under" in words else None
        assert "moving" in words or "unlinked" in words or words[1:3] == ["at", "rest"]
        news = StateNews(int(words[0]), "moving" in words, "unlinked" not in words, fence, "stopped" in words)
        self.course.state_told(news, self.by, is_old)

    def status(self, words: List[str]) -> None:
        peer, _, id = words[0].rpartition("/")
        (statement, of), rest = map(int, words[2].split("/")), words[3:]
        fence: Optional[int] = None
        error: Optional[Dict[str, Any]] = None
        if rest[:1] == ["under"]:
            fence = int(rest[1])
        elif rest:
            error = {"name": rest[0], "code": int(rest[1]), "text": f"the words of {rest[0]}"}
            error.update({"retry": True} if rest[2:] == ["retry"] else {})
        report = Report(peer or "alice", words[1], None if id == "-" else int(id), fence, statement, of, error)
        self.course.reported(report, self.by)

    def passes(self, ms: int) -> None:
        """Time passes, and the course is woken whenever it asked to be."""
        until = self.now + ms
        while (due := self.course.next_wake()) is not None and due <= until:
            self.now = max(due, self.now)
            self.course.wake(self.now)
            self.gather()
        self.now = until
        self.course.at(until)

    acts: Dict[str, Callable[[Stage, List[str]], None]] = {
        "after": lambda self, words: self.passes(int(words[0])),
        "sent": lambda self, words: self.course.sent(int(words[0])),
        "nobody": lambda self, words: self.course.sent(None),
        "refused": lambda self, words: self.course.refused(
            mom.WireError(words[0], f"the words of {words[0]}", {"code": int(words[1])})
        ),
        "unanswered": lambda self, words: self.course.unanswered(" ".join(words)),
        "old": old,
        "state": state,
        "status": status,
        "next": lambda self, words: self.course.asks(int(words[0])),
        "dropped": lambda self, words: self.course.dropped(words[0], words[1] if words[1:] else None),
        "down": lambda self, words: self.course.link_down(),
        "lagged": lambda self, words: self.course.lagged(int(words[0])),
        "lost": lambda self, words: self.course.lost(mom.Lost(words[0], words[2] if words[1:2] == ["by"] else None)),
        "asked": lambda self, words: self.course.asked(),
        "cancel": lambda self, words: self.course.cancel(),
        "released": lambda self, words: self.course.released(),
    }

    def gather(self) -> None:
        while (step := self.course.poll()) is not None:
            self.says += self.told(step)

    def told(self, step: Step) -> Iterator[str]:
        if isinstance(step, Send):
            on, to = f" on {step.on}" if step.on is not None else "", f" for {step.to}" if step.to is not None else ""
            yield f"send {self.text}{on}{to}"
        elif isinstance(step, Progress):
            yield f"tells again {step.why}" if step.why else f"tells {step.state} {step.statement}/{step.of}"
        elif isinstance(step, Do):
            yield step.name.lower()
        elif isinstance(step, CommandEnd):
            yield from ended(step)
        else:
            yield f"halted {step.value}"
            try:
                step.check("/robot/arm")
            except DriveError as error:
                yield f"says {error.text}"
                if error.hint:
                    yield f"hint {error.hint}"


def ended(end: CommandEnd) -> Iterator[str]:
    if end.kind in ("error", "refused"):
        yield f"end {end.kind} {end.name}"
    elif end.lost is not None:
        yield f"end lost {end.lost.reason}" + (f" by {end.lost.by}" if end.lost.by else "")
    else:
        yield f"end {end.name}"
    if not end.finished:
        yield f"says {end.text}"
        if end.hint:
            yield f"hint {end.hint}"


def fits(says: List[str], expected: List[str]) -> bool:
    """A line that ends in `*` leaves open the rest of it, and the last one also what follows."""
    is_open = bool(expected) and expected[-1].endswith("*")
    as_expected = all(
        said.startswith(line[:-1]) if line.endswith("*") else said == line for said, line in zip(says, expected)
    )
    return as_expected and (len(says) == len(expected) or (is_open and len(says) > len(expected)))


def dialogues() -> Iterator[Tuple[str, List[str]]]:
    """The titles and lines."""
    text = "\n".join(line for line in FILE.read_text().splitlines() if not line.startswith("#"))
    for dialogue in text.split("\n== ")[1:]:
        title, *lines = [line for line in dialogue.splitlines() if line]
        each = next((line[len("each ") :] for line in lines if line.startswith("each ")), "")
        rest = [line for line in lines if not line.startswith("each ")]
        for one in each.split(" | "):
            one, _, says = one.partition(": ")
            yield f"{title} ({one})" if one else title, [line.replace("{each}", one).replace("{says}", says) for line in rest]


ALL = list(dialogues())


@pytest.mark.parametrize("lines", [pytest.param(lines, id=title) for title, lines in ALL])
def test_dialogue(lines: List[str]) -> None:
    Stage().play(list(lines))


def test_no_dialogue_is_left_out() -> None:
    titles = [line[3:] for line in FILE.read_text().splitlines() if line.startswith("== ")]
    assert [title for title in titles if not any(played.startswith(title) for played, _ in ALL)] == []
    assert len(titles) >= 54 and len(ALL) >= 70, (len(titles), len(ALL))


BEGUN = ["command: home", "> send home"]
LOST = "> says lost /robot/token: carol has a higher level and took it; "
BEYOND: Dict[str, List[str]] = {
    "a device may say that it has ended a command whose receipt has not come": [
        *BEGUN, "lost preempted by carol", "status 7 error 0/1 halted 5101",
        "> end lost preempted by carol", LOST + "the device has ended the command",
    ],
    "what the token was lost before says so at once": [
        "without preempted by carol", "> end lost preempted by carol", LOST + "nothing of the command ran",
        "without disconnected", "> end disconnected",
        "> says the connection to the hub is lost, and the token with it; nothing of the command ran",
    ],
    "what had not left when the connection was lost does not run": [
        *BEGUN, "kept", "> end disconnected",
        "> says the connection to the hub is lost, and the token with it; nothing of the command ran",
        "cancel", "> release", "released", "> halted confirmed",
    ],
}  # fmt: skip
"""Dialogues of what this client alone has."""


@pytest.mark.parametrize("lines", [pytest.param(lines, id=title) for title, lines in BEYOND.items()])
def test_beyond_the_dialogues(lines: List[str]) -> None:
    class Wider(Stage):
        acts = {
            **Stage.acts,
            "without": lambda self, words: self.course.begin_without(
                mom.Lost(words[0], words[2] if words[1:2] == ["by"] else None)
            ),
            "kept": lambda self, words: self.course.kept_back(),
        }

    Wider().play(list(lines))


def test_what_a_card_says_is_relative() -> None:
    moves = {"moves": True}
    verbs: List[Dict[str, Any]] = [
        {"name": "move", **moves}, {"name": "by", **moves, "relative": True}, {"name": "grip", **moves, "in-place": True},
        {"name": "lamp", "moves": False},
    ]  # fmt: skip
    for script, expected in [
        ("by 1", True), ("wait 5; by 1", True), ("# by\nmove 1", False), ("move 1; by 1", False), ("grip open;by 1", True),
        ("lamp 1\n  by 1 # so far", True), ("what; by 1", True), ("", False), (" ; ", False),
    ]:  # fmt: skip
        assert is_relative({"verbs": verbs}, script) == expected, script
        assert Command(script).basis({"verbs": verbs}) == (NEWEST if expected else None)
    assert not is_relative({}, "by 1") and not is_relative({"verbs": "none"}, "by 1")
    assert Command("by 1", based_on=7).basis({"verbs": verbs}) == 7 and Command("by 1").basis(None) is None


def test_what_is_no_command() -> None:
    for wrong in ("new", True, 1.5):
        with pytest.raises(ValueError):
            Command("by 1", based_on=wrong)  # type: ignore[arg-type]
    with pytest.raises(TypeError):
        Command(b"home")  # type: ignore[arg-type]


def test_an_error_without_words_is_still_told() -> None:
    """As in the module of the same name in Rust."""
    for error, words in [
        (None, "it failed, and the device does not say why"),
        ({"text": "statement 1: no", "statement": 1}, "statement 1: no"),
        ({"text": "no", "statement": 2, "code": 7}, "statement 2: no [7]"),
        ({"text": "\x1b[2J"}, "\\u{1b}[2J"),
    ]:
        assert Report("alice", "error", error=error).error_words == words
    nameless = Whose("/robot/arm").failed(Report("alice", "error", error={"text": "no"}))
    assert (nameless.name, nameless.text, nameless.unreachable) == ("error", "no", False)


def test_texts_of_others_stay_on_their_line() -> None:
    for text, shown in [("Zoë 名前 😀", "Zoë 名前 😀"), ("a\nb\r\tc", "a\\nb\\r c"), ("\x9b2J\u202e", "\\u{9b}2J\\u{202e}")]:
        assert visible(text) == shown
    assert quoted('a "b"\n\t\\ë\x1b') == '"a \\"b\\"\\n\\t\\\\ë\\u{1b}"'
    assert lost_words("/robot/token", mom.Lost("broken", "b\nb")) == "lost /robot/token: b\\nb took it away"


def test_what_is_read_of_states_and_reports() -> None:
    def state(content: Any) -> Optional[StateNews]:
        return StateNews.read(Parcel("message", "state", content=content, id=4))

    assert state({}) == StateNews(4) and state({"moving": True, "reached": False}) == StateNews(4, True, False)
    assert state({"fence": 9, "linked": True, "stopped": True}) == StateNews(4, fence=9, stopped=True)
    assert [state(wrong) for wrong in (None, "free", {"moving": 1}, {"fence": "9"}, {"linked": None})] == [None] * 5

    def report(content: Any) -> Optional[Report]:
        return Report.read(Parcel("message", "status", content=content))

    assert report({"peer": "alice", "state": "waiting"}) == Report("alice", "waiting")
    whole = {"peer": "alice", "state": "error", "id": 7, "fence": 5, "statement": 1, "of": 2, "error": {"name": "link"}}
    assert report(whole) == Report("alice", "error", 7, 5, 1, 2, {"name": "link"})
    assert [report(wrong) for wrong in (None, {"peer": "alice"}, {**whole, "id": "7"}, {**whole, "of": 1.5})] == [None] * 4


def test_a_failure_says_what_to_do() -> None:
    end = Whose("/robot/arm").no_answer()
    with pytest.raises(CommandFailed) as caught:
        end.check()
    words = ("no device answers in /robot/arm", "see who is there: mom tree /robot")
    assert (caught.value.text, caught.value.hint, caught.value.code, caught.value.number) == (*words, "no-answer", None)
    assert str(caught.value) == f"{words[0]} ({words[1]})" and caught.value.end is end
