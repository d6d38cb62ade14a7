"""What a class declares of a device: its card, and how its scripts are read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Dict, List, Literal, Optional

import pytest

from mom.device import ERRORS, Attachment, Call, Device, DeviceError, Flag, Number, Whole, Word, verb
from mom.device.declared import DeclaredMachine
from mom.device.script import MAX_BYTES, MAX_STATEMENTS, Attachments, Script, Wait, read_script
from mom.device.words import most_similar
from mom.values import pack


class Cart(Device):
    """A cart on
    two wheels.

    It is a toy.
    """

    stops_within = 500
    cameras = ["/camera/x"]
    state = {"x": Number("mm", 0, 9, does="Along the rail"), "leds": Whole(), "on": Flag("Whether it is on"), "mode": Word("a")}

    def __init__(self) -> None:
        self.planned: List[Call] = []

    def halt(self) -> None:
        pass

    def plan(self, calls: List[Call]) -> None:
        self.planned = calls

    @verb
    async def go(self, x: Annotated[float, Number("mm", -1000, 1000)], speed: Annotated[float, Number("mm/s", min=0)] = 50) -> None:
        """Drives to a place."""

    @verb(relative=True)
    async def go_by(self, x: float) -> None:
        """Drives so far."""

    @verb(velocity=300)
    def drive(self, left: int, right: Annotated[int, Whole(max=9)]) -> None: ...

    @verb(moves=False, name="lamp")
    def _lamp(self, how: Literal["on", "off"], why: str = "dark") -> None: ...

    @verb
    def play(self, max_volume: Annotated[int, Whole("%", 0, 100)], sound: Annotated[bytes, Attachment()]) -> None: ...


def read(text: str, **attachments: bytes) -> Script:
    return read_script(DeclaredMachine(Cart()), text, Attachments(attachments))


def refusal(text: str, **attachments: bytes) -> Dict[str, Any]:
    with pytest.raises(DeviceError) as refused:
        read(text, **attachments)
    return refused.value.content()


def test_a_card_says_what_a_device_can_do() -> None:
    card = Cart.card()
    assert list(card) == ["card", "name", "does", "verbs", "state", "stops-within", "on-loss", "cameras"]
    assert (card["card"], card["name"], card["does"]) == (1, "cart", "A cart on two wheels")
    assert card["verbs"] == [
        {
            "name": "go",
            "does": "Drives to a place",
            "args": [
                {"name": "x", "type": "number", "unit": "mm", "min": -1000, "max": 1000},
                {"name": "speed", "type": "number", "unit": "mm/s", "min": 0, "default": 50},
            ],
            "moves": True,
        },
        {"name": "go-by", "does": "Drives so far", "args": [{"name": "x", "type": "number"}], "moves": True, "relative": True},
        {
            "name": "drive",
            "args": [{"name": "left", "type": "whole"}, {"name": "right", "type": "whole", "max": 9}],
            "moves": True,
            "velocity": True,
        },
        {
            "name": "lamp",
            "args": [{"name": "how", "type": "word", "choices": ["on", "off"]}, {"name": "why", "type": "word", "default": "dark"}],
            "moves": False,
        },
        {
            "name": "play",
            "args": [
                {"name": "max-volume", "type": "whole", "unit": "%", "min": 0, "max": 100},
                {"name": "sound", "type": "attachment"},
            ],
            "moves": True,
        },
    ]
    assert card["state"] == [
        {"name": "x", "type": "number", "unit": "mm", "does": "Along the rail"},
        {"name": "leds", "type": "whole"},
        {"name": "on", "type": "boolean", "does": "Whether it is on"},
        {"name": "mode", "type": "word"},
    ]
    assert (card["stops-within"], card["on-loss"], card["cameras"]) == (500, "halt", ["/camera/x"])
    assert pack(card)


def test_what_says_nothing_is_left_out_of_a_card() -> None:
    class Bell(Device):
        name = "door-bell"

        def halt(self) -> None: ...

    expected = {"card": 1, "name": "door-bell", "verbs": [], "stops-within": 1000, "on-loss": "halt"}
    assert Bell.card() == expected


def test_a_class_inherits_verbs_and_what_is_overridden_stays_one() -> None:
    class Fast(Cart):
        async def go(self, x: float = 3, speed: Annotated[int, Whole("%")] = 5) -> None:
            """Drives fast."""

        play = None  # type: ignore[assignment]

    verbs = {one["name"]: one for one in Fast.card()["verbs"]}
    assert set(verbs) == {"go", "go-by", "drive", "lamp"} and verbs["go"]["does"] == "Drives fast"
    assert [(one["type"], one["default"]) for one in verbs["go"]["args"]] == [("number", 3), ("whole", 5)]


def test_a_script_becomes_calls() -> None:
    script = read("go 1.5e2 ; wait 5\n# go 3\ngo-by -.5; drive -3 9\nlamp on; lamp off late; play 7 a", a=b"ping")
    assert script.attached == 4 and script.statements[1] == Wait(5)
    found = [(number, action.verb.method, action.arguments) for action, number in script.actions()]
    assert found == [
        (1, "go", {"x": 150.0, "speed": 50}),
        (3, "go_by", {"x": -0.5}),
        (4, "drive", {"left": -3, "right": 9}),
        (5, "_lamp", {"how": "on", "why": "dark"}),
        (6, "_lamp", {"how": "off", "why": "late"}),
        (7, "play", {"max_volume": 7, "sound": b"ping"}),
    ]
    assert isinstance(found[0][2]["x"], float) and isinstance(found[2][2]["left"], int)
    machine = DeclaredMachine(cart := Cart())
    with pytest.raises(DeviceError, match="statement 4: `drive` stands alone in its script"):
        machine.plan(script)
    machine.plan(read("go 1; wait 5; go-by 2"))
    assert [(call.verb, call.statement) for call in cart.planned] == [("go", 1), ("go-by", 3)]


GO = "`go` takes x/mm [speed/mm/s]"


@pytest.mark.parametrize(
    ("text", "words", "place", "nearest"),
    [
        ("og 5", "statement 1: there is no `og`; did you mean `go`?", (0, 1, 1), "go"),
        ("go 1;\n  waitt 5", "statement 2: there is no `waitt`; did you mean `wait`?", (8, 2, 3), "wait"),
        ("go", f"statement 1: {GO}; x is missing", (2, 1, 3), None),
        ("go 1; go x", f"statement 2: {GO}: x is a number from -1000 to 1000 mm, not `x`", (9, 1, 10), None),
        ("go 1000.1", f"statement 1: {GO}: x is a number from -1000 to 1000 mm, not `1000.1`", (3, 1, 4), None),
        ("go nan", f"statement 1: {GO}: x is a number from -1000 to 1000 mm, not `nan`", (3, 1, 4), None),
        ("go 5 -1", f"statement 1: {GO}: speed is a number of at least 0 mm/s, not `-1`", (5, 1, 6), None),
        ("go 1 2 3", "statement 1: `go` ends before `3`; is a `;` or a new line missing?", (7, 1, 8), None),
        ("go-by 1e999", "statement 1: `go-by` takes x: x is a number, not `1e999`", (6, 1, 7), None),
        ("drive 1.5 1", "statement 1: `drive` takes left right: left is a whole number, not `1.5`", (6, 1, 7), None),
        ("drive 1 10", "statement 1: `drive` takes left right: right is a whole number of at most 9, not `10`", (8, 1, 9), None),
        ("lamp onn", "statement 1: `lamp` takes how [why]: how is `on` or `off`, not `onn`; did you mean `on`?", (5, 1, 6), "on"),
        ("wait 60001", "statement 1: `wait` takes a whole number of ms from 0 to 60000, not `60001`", (5, 1, 6), None),
        ("ä" * 30, f"statement 1: there is no `{'ä' * 24}…`; did you mean `go`?", (0, 1, 1), "go"),
        ("# ä\nlamp é; go", "statement 1: `lamp` takes how [why]: how is `on` or `off`, not `é`; did you mean `on`?", (10, 2, 6), "on"),
        (" # nothing;\n;", "the script has no statement", (0, 1, 1), None),
    ],
)  # fmt: skip
def test_what_a_script_says_wrong_is_told_with_its_place(text: str, words: str, place: Any, nearest: Optional[str]) -> None:
    error = refusal(text)
    assert (error["name"], error["code"], error["text"]) == ("syntax", 5001, words)
    assert (error["position"], error["line"], error["column"]) == place and error.get("nearest") == nearest
    assert error.get("statement") == (int(words.split(":")[0].split()[1]) if words.startswith("statement") else None)


def test_scripts_are_bounded_and_their_bytes_have_to_come() -> None:
    assert "at most 65536 are read" in refusal("#" * (MAX_BYTES + 1))["text"]
    assert len(read("wait 0;" * MAX_STATEMENTS).statements) == MAX_STATEMENTS
    assert "more than 1000 statements" in refusal("wait 0;" * (MAX_STATEMENTS + 1))["text"]
    assert refusal("wait 1; play 1 a")["text"] == "statement 2: `a` did not come with the script: it has no attachments"
    assert refusal("play 1 a", b=b"", c=b"")["text"] == "statement 1: `a` did not come with the script, but b, c"
    with pytest.raises(DeviceError, match="the attachment `a` must be bytes"):
        Attachments({"a": "text"})


def test_a_swap_of_letters_is_one_change() -> None:
    assert most_similar("rde", ["green", "red"]) == "red" and most_similar("ab", ["xyz", "yz"]) == "yz"
    assert most_similar("ab", []) == "" and most_similar("m" * 65, ["m", "n"]) == "m"


def refused_class(**members: Any) -> str:
    with pytest.raises(TypeError) as refused:
        type("Toy", (Device,), {"__module__": __name__, **members})
    return str(refused.value)


def test_a_class_that_cannot_be_a_device_is_refused_when_it_is_made() -> None:
    def halt(self: Any) -> None: ...

    async def later(self: Any) -> None: ...

    def untyped(self: Any, x) -> None: ...  # type: ignore[no-untyped-def]

    def many(self: Any, *x: float) -> None: ...

    def unknown(self: Any, x: "Nothing") -> None: ...  # type: ignore[name-defined]  # noqa: F821

    def plain(self: Any) -> None: ...

    def far(self: Any, x: float = float("inf")) -> None: ...

    def perhaps(self: Any, x: Optional[float] = 1) -> None: ...

    def red(self: Any, how: Literal["on", "off"] = "of") -> None: ...  # type: ignore[assignment]

    for method in (far, red):
        assert "is nothing that a script could say" in refused_class(halt=halt, go=verb(method))
    assert "the type of `x` has to be" in refused_class(halt=halt, go=verb(perhaps))
    assert "no device can be called `a b`" in refused_class(halt=halt, name="a b")
    with pytest.raises(TypeError, match="more than 3 as the most"):
        Number("mm", 5, 3)
    with pytest.raises(TypeError, match="the choices of a word"):
        Word("on top")
    assert refused_class() == "Toy has no `halt`: every device can be halted"
    assert "Toy.halt has to be a plain function" in refused_class(halt=later)
    assert "Toy.position has to be a plain function" in refused_class(halt=halt, position=later)
    assert "the type of `x` has to be" in refused_class(halt=halt, go=verb(untyped))
    assert "plain parameters only" in refused_class(halt=halt, go=verb(many))
    assert "have to be known in its module" in refused_class(halt=halt, go=verb(unknown))
    assert "no verb can be called `wait`" in refused_class(halt=halt, wait=verb(plain))
    assert "no verb can be called `a b`" in refused_class(halt=halt, go=verb(name="a b")(plain))
    assert "two verbs `go`" in refused_class(halt=halt, go=verb(name="go")(plain), come=plain)
    for options in ({"velocity": 0}, {"velocity": 60_001}, {"velocity": 5, "relative": True}, {"relative": True, "moves": False}):
        assert "Toy.go" in refused_class(halt=halt, go=verb(**options)(plain))  # type: ignore[arg-type]
    assert "more than 0" in refused_class(halt=halt, stops_within=0)
    with pytest.raises(ValueError, match="there is no error `oops`"):
        DeviceError("oops", "")


@pytest.mark.parametrize("name", ["stops_within", "tolerance", "max_age"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1, 0, "5"])
def test_a_class_with_limits_that_are_none_is_refused(name: str, value: Any) -> None:
    assert "are finite numbers, and more than 0" in refused_class(halt=lambda self: None, **{name: value})


def test_a_generator_is_no_verb() -> None:
    def steps(self: Any) -> Any:
        yield

    async def turns(self: Any) -> Any:
        yield

    for method in (steps, turns):
        assert "Toy.go: a generator is not a verb" in refused_class(halt=lambda self: None, go=verb(method))
    with pytest.raises(DeviceError, match="a generator is not a verb"):
        machine = DeclaredMachine(cart := Cart())
        cart.go = lambda x, speed=0.0: steps(cart)  # type: ignore[method-assign]
        machine.begin(read("go 1").statements[0], 0)


def test_the_protocol_has_a_row_for_each_error() -> None:
    document = (Path(__file__).parents[3] / "docs/PROTOCOL.md").read_text()
    rows = [[cell.strip(" `") for cell in line.split("|")] for line in document.splitlines() if line.startswith("| 5")]
    numbers = {row[2]: int(row[1]) for row in rows if row[1].isdigit() and int(row[1]) > 5000}
    assert numbers == ERRORS
    assert [name for name in numbers if DeviceError(name, "").retry] == ["queue-full", "busy"]
