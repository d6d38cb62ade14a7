"""The server of a device by itself: its rest, the age of commands, requests for commands, and what it keeps whatever comes."""

from __future__ import annotations

import random
from typing import Any, Dict, List, Optional

import pytest
from device_stage import CHANNEL, TOKEN, Stage
from test_device_cases import Cart, RollingCart

import mom
from mom.clock import Age
from mom.device.fresh import Freshness, Pull, RefusedCommandError, StateGate
from mom.device.outlet import Outlet
from mom.device.rest import REST, Rest, Sample
from mom.parcel import Parcel
from mom.values import from_micros

STOPPING = 500_000


def sample(x: float, at: int) -> Optional[Sample]:
    return Sample.of({"x": x, "name": "a", "flag": True}, at)


def test_what_rolls_does_not_rest_and_what_stands_rests_after_three_tenths_of_a_second() -> None:
    rest = Rest(1.0, STOPPING)
    rest.disturb(100_000)
    # Measured before it was to stand.
    rest.observe(sample(0.0, 90_000), 500_000)
    for step in range(20):
        now = 100_000 + step * 50_000
        rest.observe(sample(step * 2.0, now), now)
        assert rest.known is None
    assert now == 1_050_000
    for later, known in ((REST - 1, None), (REST, "measured"), (2 * REST, "measured")):
        rest.observe(sample(38.5, now + later), now + later)
        assert rest.known == known
    assert rest.next_look(5) is None
    # Pushed.
    rest.observe(sample(60.0, now + 900_000), now + 900_000)
    assert rest.known is None and rest.next_look(5) == 50_005


def test_what_does_not_measure_rests_by_its_stopping_time() -> None:
    for lost in (None, sample(float("nan"), 1), Sample.of({"name": "a"}, 1)):
        rest = Rest(1.0, STOPPING)
        rest.observe(lost, 1_000)
        rest.observe(lost, STOPPING)
        assert rest.known is None
        rest.observe(lost, 1_000 + STOPPING)
        assert rest.known == "not-measured"
        rest.observe(sample(3.0, 700_000), 700_000)
        assert rest.known is None, "what is measured counts"


def test_a_heading_goes_on_at_the_full_turn_and_small_motions_add_up() -> None:
    rest = Rest(2.0, STOPPING)
    for step, angle in enumerate((359.0, 0.0, 359.6, 0.4, 359.0)):
        rest.observe(Sample.of({"heading": angle}, step * 100_000), step * 100_000)
    assert rest.known == "measured"
    rest.observe(Sample.of({"heading": 3}, 500_000), 500_000)
    assert rest.known is None
    one, two = Sample((0.0, 0.0), 0), Sample((0.8, 0.8), 1)
    assert not one.is_near(two, 1.0) and one.is_near(two, 1.2) and not one.is_near(Sample((0.0,), 0), 1.0)


def command(reference: Optional[int] = None, expires: Optional[int] = None, sender: str = "bob") -> Parcel:
    return Parcel("message", "command", CHANNEL, "wait 1", reference=reference, expires=expires, sender=sender)


def code_of(check: Any) -> Optional[str]:
    try:
        check()
    except RefusedCommandError as refused:
        return refused.wire.code
    return None


def test_only_a_surely_fresh_answer_to_the_newest_request_is_taken() -> None:
    pull = Pull(1_000_000)
    pull.ask(7, 0)
    pull.ask(8, 1_000_000)
    for reference, expires, age, code in [
        (8, 100, Age(0.05, 0.049999), None),
        (8, 100, Age(0.05, 0.05), "expired"),
        (8, 100, Age(-0.2, 0.05), None),
        (8, 100, Age(0.0, None), "expired"),
        (8, 100, None, "expired"),
        (7, 100, Age(0.0, 0.0), "expired"),
        (8, None, Age(0.0, 0.0), "bad-slot"),
        (None, 100, Age(0.0, 0.0), "bad-slot"),
    ]:
        assert code_of(lambda: pull.check(command(reference, expires), age)) == code, (reference, expires, age)
    pull.renew(1_000_001)
    assert code_of(lambda: pull.check(command(8, 100), Age(0.0, 0.0))) == "expired", "an answer is taken once"
    assert code_of(lambda: pull.check(command(sender="hub"), None)) is None


def test_a_device_that_asks_for_its_commands_takes_only_answers() -> None:
    stage = Stage.at_rest(Cart())
    stage.server.pulling(1_000_000)
    stage.act("gate bob 6")
    stage.act("grabbed 6")
    stage.heard()
    assert stage.server.asks_at(stage.gate) == stage.now
    (asked,) = stage.server.ask(stage.gate, stage.now)
    assert (asked.name, asked.content, asked.delivery) == ("next", {"wait": 1000}, "latest")
    assert stage.server.ask(stage.gate, stage.now) == [] and stage.server.asks_at(stage.gate) == stage.now + 1_000_000
    stage.age = 0
    for reference, id, states in ((1, 1, ["error"]), (asked.id, 2, ["waiting", "executing"])):
        parcel = command(reference, 500)
        parcel.fence, parcel.id, parcel.content = 6, id, "wait 100"
        stage.out = []
        stage.tell(mom.Message(parcel))
        assert [one.content["state"] for one in stage.out if one.name == "status"] == states
    assert stage.server.asks_at(stage.gate) is None, "it has something to do"
    stage.pass_time(500)
    assert stage.server.asks_at(stage.gate) is not None


def test_how_long_a_command_may_wait() -> None:
    fresh = Freshness()
    assert fresh.use_by("it", command(), None, 5) is None
    assert fresh.use_by("it", command(expires=100), None, 5) == 100_005
    assert fresh.use_by("it", command(expires=100), Age(0.04, None), 5) == 60_005
    fresh = Freshness(max_age=500_000, pace=2)
    assert fresh.use_by("it", command(), Age(0.1, 0.01), 5) == 780_005
    assert fresh.use_by("it", command(expires=100), Age(0.0, 0.0), 5) == 200_005
    assert fresh.use_by("it", command(sender="hub"), None, 5) is None


def test_no_state_holds_before_the_first_one_nor_from_an_earlier_start() -> None:
    def told(gate: StateGate, moved: bool) -> int:
        state = Parcel("message", "state")
        gate.stamp(state, moved)
        assert state.id is not None
        return state.id

    def code(gate: StateGate, based_on: Any) -> Optional[str]:
        return code_of(lambda: gate.check(Parcel("message", "command", extra={"based-on": based_on})))

    before = StateGate(from_micros(1_700_000_000_000_000))
    old = told(before, True)
    gate = StateGate(from_micros(1_700_000_000_000_500))
    assert code(gate, old) == code(gate, old + 499) == "stale-state"
    first = told(gate, False)
    assert first > old and code(gate, first) is None and code(gate, old) == "stale-state"
    gate.moving = True
    assert code(gate, first) == "stale-state" and code_of(lambda: gate.check(Parcel("message", "command"))) is None
    for wrong in ("7", -1, 1 << 53, None, True, 1.5):
        assert code(gate, wrong) == "bad-slot"


async def test_what_a_lost_link_refuses_is_sent_in_order_but_for_states() -> None:
    sent: List[str] = []
    fails = {"b", "state"}
    is_up = True

    async def send(parcel: Parcel) -> None:
        if parcel.name in fails:
            fails.discard(parcel.name)
            raise mom.ConnectionDownError("gone")
        sent.append(parcel.name)

    outlet = Outlet(send, lambda: is_up, lambda parcel: parcel.name != "useless")
    words = ["a", "state", "b", "useless", "c"]
    outlet.push([Parcel("message", word, delivery="latest" if word == "state" else None) for word in words])
    await outlet.flush()
    assert sent == ["a", "b", "c"] and not fails
    is_up = False
    outlet.push([Parcel("message", word, content=n, delivery="latest") for n, word in enumerate(("state", "state"))])
    outlet.push([Parcel("message", "status"), Parcel("message", "state", content=2, delivery="latest"), Parcel("message", "stop")])
    outlet.push([Parcel("message", "state", content=3, delivery="latest", address=["bob"])])
    await outlet.flush()
    assert sent == ["a", "b", "c"]
    is_up = True
    outlet.push([])
    await outlet.flush()
    assert sent[3:] == ["stop", "status", "state", "state"]
    outlet.push([Parcel("message", f"m{number}") for number in range(5000)])
    await outlet.flush()
    assert sent[7] == "m904" and sent[-1] == "m4999", "the oldest go"


STATEMENTS = ["wait 0", "wait 30", "wait 200", "go 100", "go -40", "by 20", "jog 50", "jog -9", "og 3", "go 2000"]


def random_line(dice: random.Random, fence: int, id: int) -> str:
    """Something that happens to a device."""
    script = "; ".join(dice.choices(STATEMENTS, k=dice.randint(1, 3)))
    on = dice.choice(["", "", " on newest", " on before", " expires 50"])
    command = f"alice command {id} {fence - dice.randint(0, 1)}{on}: {script}"
    others = [
        f"after {dice.randint(0, 400)}", f"after {dice.randint(0, 4000)}", f"frozen {dice.randint(0, 3000)}", "hub halt", "lagged",
        "down", "resumed", "rejoined", "told 0", f"bob stop {id}", f"bob unstop {id}", "bob unstop", "joined carol", "count",
        f"grabbed {fence}", f"released {fence}", f"given {fence}", "report", "expelled arm", "hub command - -: wait 20",
    ]  # fmt: skip
    return command if dice.random() < 0.5 else dice.choice(others)


@pytest.mark.parametrize("seed", range(40))
def test_whatever_comes_each_command_ends_once_and_nothing_moves_that_may_not(seed: int) -> None:
    dice = random.Random(seed)
    machine: Cart = (Cart, RollingCart)[seed % 2]()
    stage = Stage.at_rest(machine)
    stage.server.name = "arm"
    open_: Dict[int, str] = {}
    fence = 5
    for number in range(1, 150):
        fence += dice.random() < 0.1
        stage.act(random_line(dice, fence, number))
        for parcel in stage.out:
            if parcel.name != "status" or "id" not in parcel.content:
                continue
            id, word, of = parcel.content["id"], parcel.content["state"], parcel.content["of"]
            if word == "waiting":
                assert id not in open_
            elif of:
                assert id in open_, f"{id} had ended"
            open_[id] = word
            if word in ("finished", "error"):
                del open_[id]
        stage.heard()
        state = stage.server.state()
        if stage.server.latch.is_stopped or stage.server.latch.may_move() is not None:
            assert not machine.acts and state.executing is None and state.waiting == 0
        assert not (state.rest and (machine.speed or state.moving)), "what moves does not rest"
        due = stage.server.next_wake()
        assert due is None or due > stage.now or stage.server.advance(due) is not None
    stage.act("hub halt")
    assert stage.server.state().executing is None and TOKEN
