"""The client against a real broker: login, contexts, messages, events."""

from __future__ import annotations

import asyncio
import hashlib
import ssl
from pathlib import Path
from typing import List

import pytest
from conftest import PATIENCE, Broker, Cutter, heard, state

import mom


async def test_the_first_example_of_the_readme(broker: Broker, capsys: pytest.CaptureFixture[str]) -> None:
    readme = (Path(__file__).parents[1] / "README.md").read_text()
    example = readme.split("```python\n")[1].split("```")[0]
    assert len(example.strip().splitlines()) <= 10
    example = example.replace("mom://localhost", broker.address()).replace("asyncio.run(main())", "")
    there: dict = {}
    exec(example, there)
    await asyncio.wait_for(there["main"](), PATIENCE)
    assert "good morning" in capsys.readouterr().out


@pytest.mark.parametrize("scheme", ["bin", "bins", "ws", "wss", "http", "https", "mom", "moms"])
async def test_every_door(broker: Broker, scheme: str) -> None:
    image = bytes(range(256)) * 2000
    async with broker.connect("alice", scheme) as alice, broker.connect("bob", scheme) as bob:
        assert alice.name.startswith("alice") and alice.user == "alice" and alice.level == 1
        assert "limits" in alice.welcome and alice.state.word == "connected"
        chat, other = await alice.channel("/chat"), await bob.channel("/chat")
        events = other.events()
        receipt = await chat.send_acknowledged("image", {"bytes": image, "sum": hashlib.sha256(image).digest()})
        assert receipt == mom.Receipt(2, [])
        message = await heard(events, mom.Message)
        assert hashlib.sha256(message.content["bytes"]).digest() == message.content["sum"]
        assert (message.name, message.sender, message.parcel.context) == ("image", alice.name, "/chat")
    assert alice.state == mom.LinkState("closed")


@pytest.mark.parametrize("scheme", ["bins", "wss", "https"])
async def test_a_hub_with_another_certificate_hears_no_password(broker: Broker, scheme: str) -> None:
    wrong = broker.address(scheme).replace(broker.pin, "sha256:" + "0" * 64)
    with pytest.raises(mom.LocalError) as caught:
        await mom.connect(wrong, user="alice", password="alice")
    assert caught.value.code == "bad-login" and broker.pin in str(caught.value)
    with pytest.raises(mom.ConnectionDownError, match="(?i)certificate"):
        await mom.connect(wrong.split("?")[0], user="alice", password="alice", reconnect=None)
    async with mom.connect(wrong.split("?")[0], user="alice", password="alice", trust=broker.pin):
        pass


@pytest.mark.parametrize("scheme", ["bins", "wss", "https"])
async def test_a_proxy_of_the_environment(broker: Broker, scheme: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: List[str] = []

    async def pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(65536):
            writer.write(data)
        writer.close()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        asked.append((await reader.readuntil(b"\r\n\r\n")).decode())
        there, back = await asyncio.open_connection("127.0.0.1", broker.port)
        writer.write(b"HTTP/1.1 200 fine\r\n\r\n")
        await asyncio.gather(pass_on(reader, back), pass_on(there, writer), return_exceptions=True)

    proxy = await asyncio.start_server(serve, "127.0.0.1", 0)
    port = proxy.sockets[0].getsockname()[1]
    monkeypatch.setenv("HTTPS_PROXY", f"http://me:pass%20word@127.0.0.1:{port}")
    monkeypatch.delenv("NO_PROXY", raising=False)
    monkeypatch.delenv("no_proxy", raising=False)
    async with broker.connect("alice", scheme) as alice:
        assert (await alice.lookup("/chat")).kind == "channel"
    head = asked[0]
    assert head.startswith(f"CONNECT 127.0.0.1:{broker.port} HTTP/1.1") and "Basic bWU6cGFzcyB3b3Jk" in head
    proxy.close()


async def test_a_key_a_guest_and_a_nickname(broker: Broker, tmp_path: Path) -> None:
    file = tmp_path / "robot.key"
    file.write_text(broker.device.to_pem())
    key = mom.Key.from_file(file)
    assert key.public() == broker.device.public() and "PRIVATE" not in repr(key)
    async with mom.connect(broker.address(), user="robot", key=key, hub_name="lab", nickname="arm-7") as robot:
        assert (robot.name, robot.user) == ("arm-7", "robot")
        await robot.authenticate_again(key=key)
        assert robot.name == "arm-7" and (await robot.lookup("/chat")).kind == "channel"
    async with mom.connect(broker.address(), guest=True) as guest:
        assert guest.user == "guest"
    with pytest.raises(mom.LocalError, match="nothing was signed"):
        await mom.connect(broker.address(), user="robot", key=key, hub_name="other")
    with pytest.raises(mom.RefusedError) as caught:
        await mom.connect(broker.address(), user="robot", key=mom.Key.generate())
    assert caught.value.code == "bad-login"


async def test_a_certificate(broker: Broker) -> None:
    trust = ssl.create_default_context(cafile=str(broker.folder / "hub.crt"))
    trust.load_cert_chain(broker.folder / "robot.pem")
    address = f"bins://localhost:{broker.port}"
    async with mom.connect(address, user="robot", certificate=True, trust=trust) as robot:
        assert robot.user == "robot"


def test_what_is_no_key_is_refused(tmp_path: Path) -> None:
    for text in ("", "secret", "-----BEGIN PUBLIC KEY-----\nMCowBQYDK2VwAyEA\n-----END PUBLIC KEY-----\n"):
        with pytest.raises(mom.LocalError) as caught:
            mom.Key.from_pem(text)
        assert caught.value.code == "bad-encoding"
    with pytest.raises(mom.LocalError, match="no-such.key"):
        mom.Key.from_file(tmp_path / "no-such.key")


async def test_a_refused_login_is_typed(broker: Broker) -> None:
    with pytest.raises(mom.RefusedError) as caught:
        await mom.connect(broker.address(), user="alice", password="guess", nickname="\u0430lice")
    error = caught.value
    assert (error.code, error.number) in (("bad-login", 201), ("bad-name", 222)) and error.text


@pytest.mark.parametrize("proof", [{"user": "a"}, {"password": "x"}, {"user": "a", "password": "b", "guest": True}, {}])
async def test_exactly_one_proof(proof: dict) -> None:
    with pytest.raises(mom.LocalError):
        mom.connect("bin://localhost", **proof)


async def test_nobody_is_connected_to_for_a_password_that_others_could_read() -> None:
    for address in ("bin://192.0.2.1", "ws://lab.example.org", "http://lab.example.org"):
        for proof in ({"user": "alice", "password": "x"}, {"token": "a.b.c"}):
            with pytest.raises(mom.LocalError, match="nothing was sent") as caught:
                await mom.connect(address, **proof)
            assert caught.value.code == "insecure"


async def test_contexts(broker: Broker) -> None:
    async with broker.connect("carol") as carol:
        info = await carol.create("/lab", {"kind": "session"})
        assert info.path == "/lab" and info.kind == "session"
        try:
            lab = await carol.session("/lab")
            events = lab.events()
            await lab.create("notes", {"kind": "channel", "keep": {"parcels": 2}})
            created = await heard(events, mom.Created)
            assert created.info.path == "/lab/notes"
            assert [child.path for child in await lab.list()] == ["/lab/notes"]
            assert (await carol.lookup("/lab/notes")).kind == "channel"
            assert (await carol.info("/lab/notes"))["keep"]["parcels"] == 2
            notes = await carol.channel("/lab/notes")
            for number in range(3):
                await notes.send_acknowledged("note", number)
            assert [member.user for member in await carol.members("/lab/notes")] == ["carol"]
            assert (await carol.stats("/lab/notes"))["sent"] == 3
            async with broker.connect("carol") as late:
                told = (await late.channel("/lab/notes")).events()
                kept = [await heard(told, mom.Message) for _ in range(2)]
                assert [(one.content, one.parcel.history) for one in kept] == [(1, True), (2, True)]
            await carol.delete("/lab/notes")
            assert (await heard(events, mom.Deleted)).path == "/lab/notes"
        finally:
            await carol.delete("/lab")
        with pytest.raises(mom.RefusedError) as caught:
            await carol.channel("/lab/notes")
        assert caught.value.code == "unknown-path"
        with pytest.raises(mom.RefusedError) as caught:
            await carol.token("/chat")
        assert caught.value.code == "wrong-kind"


async def test_who_comes_and_goes(broker: Broker) -> None:
    async with broker.connect("alice") as alice:
        events = (await alice.channel("/chat")).events()
        async with broker.connect("bob") as bob:
            await bob.channel("/chat")
            joined = await heard(events, mom.Joined)
            assert (joined.member.user, joined.member.level) == ("bob", 1)
        left = await heard(events, mom.Left)
        assert left.member == joined.member


async def test_messages_have_all_that_was_said(broker: Broker) -> None:
    async with broker.connect("alice") as alice, broker.connect("bob") as bob:
        chat, events = await alice.channel("/chat"), (await bob.channel("/chat")).events()
        number = await chat.send(
            "say", None, to=[bob.name], priority=-3, expires=5, delivery="latest", echo=False, reference=4,
            based_on=7, trace="00-" + "1" * 32 + "-" + "2" * 16 + "-01", slots={"colour": b"red"},
        )  # fmt: skip
        parcel = (await heard(events, mom.Message)).parcel
        assert (parcel.id, parcel.address, parcel.priority, parcel.expires) == (number, [bob.name], -3, 5000)
        assert (parcel.delivery, parcel.echo, parcel.reference, parcel.content) == ("latest", False, 4, None)
        assert parcel.extra["colour"] == b"red" and parcel.extra["based-on"] == 7 and not parcel.has_content
        assert parcel.timestamp and parcel.received and abs(parcel.received - parcel.timestamp).total_seconds() < 5


async def test_refusals_of_messages(broker: Broker) -> None:
    async with broker.connect("alice") as alice:
        chat, arm = await alice.channel("/chat"), await alice.channel("/robot/arm")
        events, others = chat.events(), arm.events()
        number = await chat.send("say", "all or nothing", to=["nobody"])
        refused = await heard(events, mom.Refused)
        assert (refused.id, refused.error.code) == (number, "unknown-peer")
        with pytest.raises(mom.RefusedError) as caught:
            await arm.send_acknowledged("command", "grip open")
        assert (caught.value.code, caught.value.number) == ("not-owner", 204)
        await arm.send("command", "grip open")
        assert (await heard(others, mom.Refused)).error.code == "not-owner"
        with pytest.raises(mom.LocalError) as local:
            await chat.send("say", float("nan"))
        assert local.value.code == "not-encodable"
        with pytest.raises(mom.RefusedError) as large:
            await chat.send("say", bytes(9 << 20))
        assert large.value.code == "too-long"


async def test_a_stop_overtakes_an_image(broker: Broker) -> None:
    """The image is cut into chunks, so that the stop arrives first though it was said later."""
    async with broker.connect("carol") as carol, broker.connect("bob") as bob:
        chat, events = await carol.channel("/chat"), (await bob.channel("/chat")).events()
        for _ in range(3):
            await chat.send("image", bytes(1 << 20), echo=False)
        await chat.send("stop", echo=False)
        assert (await heard(events, mom.Message)).name == "stop"
        assert (await heard(events, mom.Message)).name == "image"


async def test_a_message_of_more_than_what_may_be_unacknowledged_leaves_at_once(broker: Broker) -> None:
    """The hub is asked what it has read; by itself it would say so with the next sign of life, after 10 s."""
    async with broker.connect("alice") as alice:
        chat = await alice.channel("/chat")
        for _ in range(10):
            # The first signs of life, which measure the clock, are over then.
            await chat.send_acknowledged("note")
        sent = chat.send_acknowledged("image", bytes(5 << 20), echo=False)
        assert (await asyncio.wait_for(sent, 5)).delivered == 0


async def test_events_are_bounded_and_losses_are_told(broker: Broker) -> None:
    async with broker.connect("alice", event_buffer=5) as alice:
        chat = await alice.channel("/chat")
        events = chat.events()
        for number in range(20):
            await chat.send_acknowledged("count", number)
        taken: List[mom.Event] = []
        while not (taken and isinstance(taken[-1], mom.Message) and taken[-1].content == 19):
            taken.append(await asyncio.wait_for(events.__anext__(), PATIENCE))
        # Beside them it may have been told of a stop that another test said there.
        counts = [event for event in taken if isinstance(event, mom.Message)]
        assert isinstance(taken[0], mom.Lagged) and taken[0].lost == 20 - len(counts)
        events.close()
        await chat.send_acknowledged("count", 20)
        assert [event async for event in events] == []


async def test_thinning(broker: Broker) -> None:
    async with broker.connect("alice") as alice, broker.connect("bob") as bob:
        await alice.channel("/chat", rate="2/s")
        chat = await bob.channel("/chat")
        assert (await alice.info("/chat"))["rate"] in ("2/s", 2)
        joined = await alice.channel("/chat")
        await joined.thin()
        assert "rate" not in await alice.info("/chat")
        await chat.leave()
        assert all(member.user != "bob" for member in await alice.members("/chat"))


async def test_as_another_user_it_is_another_peer(broker: Broker) -> None:
    async with broker.connect("bob") as bob:
        chat, guard = await bob.channel("/chat"), await (await bob.token("/robot/token")).grab()
        events = chat.events()
        bob._driver.credentials.user = "alice"
        await bob.authenticate_again(password="alice")
        assert bob.user == "alice" and (await guard.lost()).reason == "disconnected"
        await heard(events, mom.LinkDown)
        await heard(events, mom.Rejoined)
        await chat.send_acknowledged("say")
        assert (await heard(events, mom.Message)).sender == bob.name


async def test_the_age_of_messages(broker: Broker) -> None:
    async with broker.connect("alice") as alice, broker.connect("bob") as bob:
        chat, events = await alice.channel("/chat"), (await bob.channel("/chat")).events()
        age = None
        while age is None or age.error is None:
            await chat.send_acknowledged("tick")
            age = bob.clock.age((await heard(events, mom.Message)).parcel)
        assert -0.1 < age.seconds < PATIENCE and age.error < 1
        time, error = bob.clock.now() or (None, 1.0)
        assert time is not None and error < 1


async def test_managing_peers_are_asked(broker: Broker) -> None:
    async with broker.connect("carol") as carol, broker.connect("bob") as bob:
        await carol.create("/club", {"kind": "channel", "manager": "self", "transient": True})
        try:
            await carol.channel("/club")
            questions = carol.consults()
            answers = [True, False]

            async def answer() -> None:
                async for question in questions:
                    await question.answer(answers.pop(0), "no more")
                    if not answers:
                        return

            answering = asyncio.ensure_future(answer())
            await bob.channel("/club")
            with pytest.raises(mom.RefusedError) as caught:
                await (await bob.channel("/club")).send_acknowledged("hello")
            assert caught.value.code == "declined"
            await asyncio.wait_for(answering, PATIENCE)
            questions.close()
        finally:
            await carol.delete("/club")


async def test_invited_and_expelled(broker: Broker) -> None:
    async with broker.connect("carol") as carol, broker.connect("bob") as bob:
        others, chat = bob.unaddressed(), (await bob.channel("/chat")).events()
        await carol.invite("/robot", bob.name)
        assert (await heard(others, mom.Invited)).path == "/robot"
        await carol.expel("/chat", bob.name, "enough", time=0.001)
        expelled = await heard(chat, mom.Expelled)
        assert (expelled.peer, expelled.text) == (bob.name, "enough")
        assert await asyncio.wait_for(chat.next(), PATIENCE) is None, "its events are over"


async def test_the_hub_comes_later_and_comes_back(own_broker: Broker) -> None:
    own_broker.stop()
    words: List[str] = []
    patient = mom.Reconnect(first=0.01, most=0.05)
    coming = asyncio.ensure_future(
        own_broker.connect(reconnect=patient, on_state=lambda state: words.append(state.word))._run()
    )
    while words.count("trying") < 3:
        await asyncio.sleep(0.01)  # tidy: looks again until it has tried thrice
    own_broker.start()
    client = await asyncio.wait_for(coming, PATIENCE)
    chat = await client.channel("/chat")
    events, others = chat.events(), client.unaddressed()
    # Beside the loop, so that the client reads the hub's last words before it writes to a hub that is gone.
    await asyncio.to_thread(own_broker.stop)
    await heard(events, mom.LinkDown)
    with pytest.raises(mom.MomError):
        await chat.send("say", "nobody there")
    own_broker.start()
    await heard(events, mom.Rejoined)
    assert (await chat.send_acknowledged("say", "again")).delivered == 1
    await client.close()
    await heard(others, mom.LinkDown)
    assert words[-1] == "closed" and "connected" in words
    with pytest.raises(mom.ClosedError):
        await chat.send("say", "too late")


async def test_without_reconnect_a_lost_connection_closes(broker: Broker, cutter: Cutter) -> None:
    client = await mom.connect(f"bin://127.0.0.1:{cutter.port}", user="alice", password="alice", reconnect=None)
    events = (await client.channel("/chat")).events()
    cutter.cut()
    closed = await state(client, "closed")
    assert closed.error and closed.error.code == "disconnected"
    with pytest.raises(mom.ClosedError):
        await client.list()
    while await asyncio.wait_for(events.next(), PATIENCE) is not None:
        pass
    await client.close()


async def test_attempts_may_be_bounded(unused_tcp_port: int) -> None:
    bounded = mom.Reconnect(first=0.01, most=0.02, give_up_after=0.1)
    with pytest.raises(mom.ConnectionDownError):
        await mom.connect(f"mom://127.0.0.1:{unused_tcp_port}", guest=True, reconnect=bounded)
