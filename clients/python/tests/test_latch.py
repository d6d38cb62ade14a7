"""What a device makes of stops: the cases of `tests/cases/latch.json`, which all clients replay."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Dict

import pytest

import mom

CASES = json.loads((Path(__file__).parents[3] / "tests/cases/latch.json").read_text())


def said(name: str, content: Any = None, sender: str = "bob", **slots: Any) -> mom.Message:
    return mom.Message(mom.Parcel("message", name, "/robot/arm", content, sender=sender, extra=slots))


def event_of(step: Dict[str, Any]) -> mom.Event:
    kind = step["event"]
    if kind in ("stop", "unstop"):
        return said(kind, None, step.get("sender", "bob"), **({"stop": step["number"]} if "number" in step else {}))
    if kind == "state":
        return mom.Stops("/robot/arm", mom.StopState.of({"stopped": False, "only": [], **step}))
    others: Dict[str, mom.Event] = {
        "gap": mom.Lagged(3),
        "link-down": mom.LinkDown(),
        "resumed": mom.StateChanged(mom.LinkState("connected")),
    }
    return others[kind]


@pytest.mark.parametrize("case", CASES, ids=[case["name"] for case in CASES])
def test_case(case: Dict[str, Any]) -> None:
    latch = mom.Latch()
    for number, step in enumerate(case["steps"], 1):
        reaction = latch.observe(event_of(step))
        found = (reaction.word if reaction else None, latch.may_move() is None, latch.number)
        assert found == (step["turn"], step["moves"], step["says"]), f"step {number}, {json.dumps(step)}"


def test_there_are_cases() -> None:
    assert len(CASES) >= 21 and len({case["name"] for case in CASES}) == len(CASES)


def test_a_latch_says_who_stopped_the_device_and_why() -> None:
    latch = mom.Latch()
    assert latch.may_move() == mom.Held("unknown", "the hub has not said yet whether it is stopped")
    assert latch.word() == {"stop": 0, "stopped": False}
    assert latch.observe(said("stop", "smoke", stop=3)) == mom.Reaction("stop", "stopped by bob: smoke")
    assert latch.may_move() == mom.Held("stopped", "stopped by bob: smoke")
    # The hub says it for another peer.
    latch.observe(said("stop", {"by": "carol", "reason": "fire"}, "hub", stop=4))
    assert latch.may_move() == mom.Held("stopped", "stopped by carol: fire")
    assert latch.word() == {"stop": 4, "stopped": True}
    latch.observe(said("unstop", stop=4))
    assert latch.word() == {"stop": 4, "stopped": False}


def test_the_stop_of_the_hub_after_a_loss_is_its_word_how_the_device_stands() -> None:
    latch = mom.Latch()
    latch.observe(mom.Stops("/robot/arm", mom.StopState()))
    latch.observe(mom.LinkDown())
    latch.observe(said("stop", "smoke", "bob", stop=7))
    latch.observe(said("unstop", stop=7))
    held = latch.may_move()
    assert held is not None and held.word == "unknown", "a peer's is not"
    latch.observe(said("stop", {"by": "bob"}, "hub", stop=8))
    latch.observe(said("unstop", stop=8))
    assert latch.may_move() is None


def test_a_stop_of_its_own_is_not_yet_one_of_the_hub() -> None:
    latch = mom.Latch()
    assert latch.stop_itself("bumper") == mom.Reaction("stop", "bumper")
    assert latch.is_own and latch.is_stopped and latch.word() == {"stop": 0, "stopped": False}
    latch.stop_itself("another")
    assert latch.may_move() == mom.Held("own", "stopped by itself: bumper")
    latch.observe(said("stop", stop=1))
    assert not latch.is_own and latch.word() == {"stop": 1, "stopped": True}


@pytest.mark.parametrize("slot", [-1, 1.5, "7", True, None])
def test_what_is_no_number_names_no_stop(slot: Any) -> None:
    assert said("stop", stop=slot).stop is None
