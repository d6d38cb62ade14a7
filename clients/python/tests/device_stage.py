"""The stage of a dialogue with a device: its server, with a clock and a gate that the lines move.

`tests/cases/README.md` says what the lines of `tests/cases/device.txt` mean.
"""

from __future__ import annotations

import asyncio
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Optional, Tuple

import mom
from mom.device import Device
from mom.device.declared import DeclaredMachine
from mom.device.machine import Machine
from mom.device.server import DeviceServer, Resumed
from mom.parcel import Parcel
from mom.values import EPOCH

FILE = Path(__file__).parents[3] / "tests/cases/device.txt"
CHANNEL, TOKEN = "/robot/arm", "/robot/token"
MS = 1000

Dialogue = Tuple[str, str]
"""Its title and its lines."""


class Stage:
    """A device's server with a clock and a gate that a dialogue moves."""

    def __init__(self, machine: Machine) -> None:
        self.server: DeviceServer[Machine] = DeviceServer(machine, CHANNEL, EPOCH)
        self.gate = mom.FenceGate()
        self.now = 0
        self.age: Optional[int] = None
        """ms that the next commands are old, with an error of 10 ms."""
        self.out: List[Parcel] = []
        self.states: List[int] = []
        """The ids of the states that were told, in order."""
        self.fence: Optional[int] = None
        """The newest fence under which it has said that it stands."""
        self.stops: List[Optional[int]] = []
        """The ids of the stops that it has said, and that have not come back."""
        self.newest: Dict[str, Any] = {}
        """The newest state that was told."""

    @staticmethod
    def at_rest(machine: Machine) -> Stage:
        """A device that rests under fence 5."""
        return Stage(machine).comes_to_rest()

    def comes_to_rest(self) -> Stage:
        """This one, under fence 5."""
        for line in ("told 0", "grabbed 5", "rests"):
            self.act(line)
        heard = self.heard()
        assert heard and heard[-1].startswith("state free at rest") and self.fence == 5, heard
        return self

    def play(self, dialogue: str) -> None:
        """Plays its lines: those with `>` are what must have been said since the line before."""
        lines = [line.strip() for line in dialogue.splitlines() if line.strip()]
        while lines:
            line = lines.pop(0)
            self.act(line)
            expected = []
            while lines and lines[0].startswith("> "):
                expected.append(lines.pop(0)[2:])
            found = self.heard()
            fits = len(found) == len(expected) and all(map(_fits, found, expected))
            assert fits, f"after `{line}`: {found} != {expected}"

    def tell(self, event: mom.Event) -> None:
        age = None if self.age is None else mom.Age(self.age / 1000, 0.01)
        self.out += self.server.handle(event, self.gate, age, self.now)

    def pass_time(self, ms: int) -> None:
        """Lets ms pass as a punctual driver does."""
        until = self.now + ms * MS
        while (due := self.server.next_wake()) is not None and due <= until:
            self.out += self.server.advance(due)
        self.now = until
        self.out += self.server.advance(until)

    def pass_until(self, what: str, is_so: Callable[[], bool]) -> None:
        """Lets time pass until it is so, for as long as a device may take for it."""
        for _ in range(2 * self.server.machine.stopping_time // MS + 70_000):
            if is_so():
                return
            self.pass_time(1)
        raise AssertionError(f"{what} never: {self.server.state()}")

    def act(self, line: str) -> None:
        """Does one line of a dialogue."""
        if line.startswith("unheard "):
            self.act(line[len("unheard ") :])
            self.heard()
            return
        before, _, script = line.partition(": ")
        words = before.split(" ")
        name, rest = words[0], words[1:]
        if name == "max-age":
            self.server.with_max_age(int(rest[0]) * MS)
        elif name == "name":
            self.server.name = rest[0]
        elif name == "age":
            self.age = int(rest[0])
        elif name == "after":
            self.pass_time(int(rest[0]))
        elif name == "frozen":
            # The driver had no turn meanwhile.
            self.now += int(rest[0]) * MS
            self.out += self.server.advance(self.now)
        elif words == ["rests"]:
            self.pass_until("it rests", self._has_come_to_rest)
            self._leave_out_motion()
        elif words == ["ends"]:
            self.pass_until("all ends", lambda: not self._is_busy())
            self._leave_out_motion()
        elif name == "said":
            assert str(self.newest.get(rest[0], "-")) == rest[1], f"{rest[0]} of the newest state"
        elif name == "gate":
            owner, fence = rest
            guard: Dict[str, Any] = {"token": TOKEN, "names": ["command"], "fence": int(fence)}
            self.gate.joined({"guard": guard if owner == "-" else {**guard, "owner": owner}})
        elif name == "fill":
            for number in range(1, int(rest[0]) + 1):
                self.command("alice", [str(number), "5"], "wait 1000")
            self.out = []
        elif words == ["pushed"]:
            self.out += self.server.note(self.now, lambda machine: getattr(machine, "device", machine).push())
        elif words in (["pressed"], ["reset"]):
            getattr(self.server.machine, "device", self.server.machine).is_pressed = words == ["pressed"]
        elif name == "kept":
            kept = getattr(self.server.machine, "device").kept
            assert (self.now - kept <= 100 * MS) == (rest == ["alive"]), f"it was kept alive at {kept} of {self.now}"
        elif words == ["report"]:
            self.out += self.server.report()
        elif rest[:1] == ["command"]:
            self.command(name, rest[1:], script)
        else:
            self.tell(self.event(line, name, rest))

    def _has_come_to_rest(self) -> bool:
        # What waits for that begins at once, and then it rests no more.
        return any(map(_tells_rest, self.out)) or self.server.state().rest is not None

    def _leave_out_motion(self) -> None:
        """Leaves out the states that do not tell of rest: bodies roll for different times."""
        self.states += [parcel.id or 0 for parcel in self.out if parcel.name == "state"]
        self.out = [parcel for parcel in self.out if parcel.name != "state" or _tells_rest(parcel)]

    def _is_busy(self) -> bool:
        state = self.server.state()
        return state.executing is not None or state.waiting > 0

    def event(self, line: str, name: str, rest: List[str]) -> mom.Event:
        """What a line tells."""
        if name == "told":
            return mom.Stops(CHANNEL, mom.StopState(int(rest[0]), rest[1:] == ["stopped"]))
        if name in ("released", "given", "returned", "expired"):
            return mom.Released(TOKEN, "alice", name, int(rest[0]))
        events: Dict[str, Callable[[], mom.Event]] = {
            "down": mom.LinkDown,
            "rejoined": mom.Rejoined,
            "resumed": Resumed,
            "lagged": lambda: mom.Lagged(3),
            "count": lambda: mom.Count(300),
            "joined": lambda: mom.Joined(mom.Member(rest[0], rest[0], 1)),
            "grabbed": lambda: mom.Grabbed(TOKEN, "alice", 1, int(rest[0]), None),
            "expelled": lambda: mom.Expelled(CHANNEL, rest[0], None, "arm~2 is the device here now"),
        }
        if name == "rejoined":
            # What it had said before does not come back.
            self.stops.clear()
        if name in events:
            return events[name]()
        assert len(rest) in (1, 2), f"no such line: {line}"
        said = Parcel("message", rest[0], CHANNEL, sender=name)
        said.extra = {"stop": int(rest[1])} if len(rest) == 2 else {}
        if rest[0] == "stop" and name == self.server.name and self.stops:
            said.id = self.stops.pop(0)
        return mom.Message(said)

    def command(self, sender: str, words: List[str], script: str) -> None:
        """`[id fence [expires ms | on state]]` of a command."""
        parcel = Parcel("message", "command", CHANNEL, sender=sender)
        if words:
            parcel.content = script
            parcel.id, parcel.fence = (None if word == "-" else int(word) for word in words[:2])
        if words[2:3] == ["expires"]:
            parcel.expires = int(words[3])
        elif words[2:3] == ["on"]:
            parcel.extra["based-on"] = self.state_of(words[3])
        else:
            assert not words[2:], f"no such command: {words}"
        self.tell(mom.Message(parcel))

    def state_of(self, word: str) -> Any:
        """The id of a state that a dialogue names."""
        if word == "next":
            return self.states[-1] + 1
        places = {"newest": -1, "before": -2, "first": 0}
        if word in places:
            return self.states[places[word]]
        return int(word) if word.lstrip("-").isdigit() else word

    def heard(self) -> List[str]:
        """What was said since, one line each; states while the device carries something out and moves are left out."""
        lines: List[str] = []
        out, self.out = self.out, []
        for parcel in out:
            assert parcel.context == CHANNEL
            if parcel.name == "state":
                assert parcel.id is not None
                # Of those that were passed over it is known already.
                if parcel.id not in self.states:
                    assert not self.states or self.states[-1] < parcel.id, "ids of states rise"
                    self.states.append(parcel.id)
                self.newest = parcel.content
            if parcel.name == "stop":
                self.stops.append(parcel.id)
            line = line_of(parcel)
            if line is None:
                continue
            fence = parcel.content.get("fence")
            if parcel.name == "state" and fence != self.fence:
                assert fence is None or fence > (self.fence or 0), "fences rise"
                self.fence = fence
                line += ", no fence" if fence is None else f", fence {fence}"
            # While it comes to rest it says so again and again.
            if lines[-1:] != [line] or not line.endswith(" moving"):
                lines.append(line)
        return lines


class VirtualLoop(asyncio.SelectorEventLoop):
    """A loop whose time is that of a dialogue."""

    def __init__(self) -> None:
        super().__init__()
        self.micros = 0

    def time(self) -> float:
        return self.micros / 1e6

    def settle(self) -> None:
        """Lets all that is due happen."""
        for _ in range(8):
            self.call_soon(self.stop)
            self.run_forever()

    def next_due(self) -> int:
        """When a timer is due next, in µs."""
        timers: Any = getattr(self, "_scheduled")
        return min((round(timer.when() * 1e6) for timer in timers if not timer.cancelled()), default=1 << 60)


class DeclaredStage(Stage):
    """The stage of a device that declares its verbs: their timers pass with the time of the dialogue."""

    def __init__(self, machine: DeclaredMachine) -> None:
        super().__init__(machine)
        self.loop: VirtualLoop = machine.device.loop  # type: ignore[attr-defined]
        asyncio.set_event_loop(self.loop)
        machine.on_end = lambda task: self.out.extend(self.server.note(self.now, lambda _: machine.ended(task, self.now)))

    def act(self, line: str) -> None:
        self.loop.micros = self.now
        if line.startswith("frozen"):
            self.loop.micros += int(line.split()[1]) * 1000
        super().act(line)
        self.loop.settle()

    def pass_time(self, ms: int) -> None:
        until = self.now + ms * 1000
        while True:
            self.loop.settle()
            due = self.server.next_wake()
            due = min(until if due is None else due, self.loop.next_due())
            if due >= until:
                break
            self.now = self.loop.micros = max(due, self.now)
            self.out += self.server.advance(self.now)
        self.now = self.loop.micros = until
        self.out += self.server.advance(until)
        self.loop.settle()


def declared(device: Device) -> DeclaredMachine:
    """The machine of a device that has a loop of the dialogue's time."""
    return DeclaredMachine(device, device.loop.time)  # type: ignore[attr-defined]


@contextmanager
def declared_stage(device: Device) -> Iterator[DeclaredStage]:
    """It rests under fence 5."""
    machine = declared(device)
    stage = DeclaredStage(machine)
    try:
        stage.comes_to_rest()
        yield stage
    finally:
        machine.give_up()
        stage.loop.settle()
        stage.loop.close()


def _tells_rest(parcel: Parcel) -> bool:
    return parcel.name == "state" and "rest" in parcel.content


def _fits(heard: str, line: str) -> bool:
    """Whether what is heard is what a line says; ` *` stands for whatever a state tells of motion."""
    return heard in [line.replace(" *", motion) for motion in ("", " moving", " at rest")]


def line_of(parcel: Parcel) -> Optional[str]:
    """A parcel of a device as a line; `None` of a state while it carries something out and moves."""
    to = "".join(f" to {peer}" for peer in parcel.address or [])
    if parcel.name == "stop":
        return f"stop{to}"
    if parcel.name != "state":
        return _status(parcel)
    content = parcel.content
    assert (parcel.delivery, parcel.echo) == ("latest", False)
    if content["moving"] and "executing" in content:
        return None
    # Until it is known that it rests, it is not said to stand.
    rests = " moving" if content["moving"] else " at rest" if "rest" in content else ""
    estop = " estop" if content.get("estop") else ""
    return f"state{to} {'stopped' if content['stopped'] else 'free'}{estop}{rests}"


def _status(parcel: Parcel) -> str:
    content = parcel.content
    assert (parcel.delivery, parcel.echo) == (None, False)
    assert parcel.reference == content.get("id"), "it answers the command"
    of = f"{content['statement']}/{content['of']}"
    line = f"status {content['peer']}/{content.get('id', '-')} {content['state']} {of}"
    error = content.get("error")
    if error is not None:
        assert error["text"]
        line += f" {error['name']} {error['code']}"
    return line


def dialogues(statements: Dict[str, Optional[str]], has: Callable[[str], bool], machine: Machine) -> List[Dialogue]:
    """Those of the file that a machine can play, with its statements; each as often as it says.

    `statements` are by the words of the file; `has` says whether the machine has what a dialogue needs.
    """
    text = "\n".join(line for line in FILE.read_text().splitlines() if not line.startswith("#"))
    words = {**statements, "stops-within": str(machine.stopping_time // MS)}
    found: List[Dialogue] = []
    for dialogue in text.split("\n== ")[1:]:
        title, _, rest = dialogue.partition("\n")
        lines = rest.splitlines()
        needs = [line[len("needs ") :] for line in lines if line.startswith("needs ")]
        each = [one for line in lines if line.startswith("each ") for one in line[len("each ") :].split(" | ")]
        if not all(map(has, needs)):
            continue
        lines = [line for line in lines if not line.startswith(("needs ", "each "))]
        for one in each or [""]:
            played = "\n".join(lines).replace("{each}", one)
            for word, statement in words.items():
                played = played.replace("{" + word + "}", statement or "{" + word + "}")
            assert "{" not in played, f"{title}: {played}"
            found.append((f"{title} ({one})" if one else title, played))
    return found
