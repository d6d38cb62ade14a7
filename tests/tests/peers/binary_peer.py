"""A peer that speaks the binary form of docs/PROTOCOL.md, with nothing but a socket.

    binary_peer.py PORT USER

It does what simple_peer.py does, with a MessagePack of its own, and names contexts by the numbers it learns.
"""

import hashlib
import json
import socket
import struct
import sys

PREFACE = b"\x8fMOM\x01\x00"
FAMILIES = ["message", "login", "context", "token", "manager", "event", "reply", "error", "time"]
CLASSES = ["reliable", "latest", "fleeting"]
WORDS = """command state status image chat stop unstop halt login answer resume logout create lookup list info stats
join leave delete members invite expel grab release renew give accept decline request break inhibit uninhibit consult
verdict joined left created deleted grabbed released requested offer lapsed queued invited expelled dropped notice ok
challenge ping pong hub""".split()


class Bytes:
    """Bytes read from their front."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, count):
        piece = self.data[self.at:self.at + count]
        assert len(piece) == count, "the frame ends too early"
        self.at += count
        return piece

    def unpack(self, form):
        return struct.unpack(">" + form, self.take(struct.calcsize(form)))[0]

    def varint(self):
        number = shift = 0
        while True:
            byte = self.take(1)[0]
            number |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return number

    def zigzag(self):
        number = self.varint()
        return number >> 1 ^ -(number & 1)

    def name(self):
        key = self.varint()
        return WORDS[key >> 1] if key & 1 else self.take(key >> 1).decode()

    def value(self):
        """One MessagePack value."""
        mark = self.take(1)[0]
        if mark < 0x80 or mark >= 0xE0:
            return mark if mark < 0x80 else mark - 256
        if mark < 0x90:
            return self.map(mark & 15)
        if mark < 0xA0:
            return [self.value() for _ in range(mark & 15)]
        if mark < 0xC0:
            return self.take(mark & 31).decode()
        if mark in (0xC0, 0xC2, 0xC3):
            return {0xC0: None, 0xC2: False, 0xC3: True}[mark]
        numbers = dict(zip([0xCA, 0xCB, 0xCC, 0xCD, 0xCE, 0xCF, 0xD0, 0xD1, 0xD2, 0xD3], "fdBHIQbhiq"))
        if mark in numbers:
            return self.unpack(numbers[mark])
        if mark in (0xC4, 0xC5, 0xC6):
            return self.take(self.unpack("BHI"[mark - 0xC4]))
        if mark in (0xD9, 0xDA, 0xDB):
            return self.take(self.unpack("BHI"[mark - 0xD9])).decode()
        if mark in (0xDC, 0xDD):
            return [self.value() for _ in range(self.unpack("HI"[mark - 0xDC]))]
        if mark in (0xDE, 0xDF):
            return self.map(self.unpack("HI"[mark - 0xDE]))
        assert mark == 0xC7 and self.take(2) == b"\x0c\xff", f"mark {mark:#x}"
        nanos, seconds = self.unpack("I"), self.unpack("q")
        return {"micros": seconds * 1000000 + nanos // 1000}

    def map(self, count):
        return {self.value(): self.value() for _ in range(count)}


def varint(number):
    out = bytearray()
    while number >= 0x80:
        out.append(number & 0x7F | 0x80)
        number >>= 7
    out.append(number)
    return bytes(out)


def spelled(name):
    return varint(WORDS.index(name) << 1 | 1) if name in WORDS else varint(len(name.encode()) << 1) + name.encode()


def packed(value):
    """Strings and small maps of them as MessagePack."""
    if isinstance(value, dict):
        return bytes([0x80 | len(value)]) + b"".join(packed(key) + packed(item) for key, item in value.items())
    return b"\xdb" + struct.pack(">I", len(value.encode())) + value.encode()


# In the order of their bits: slot, and how it is read.
READERS = [
    ("number", Bytes.varint), ("name", Bytes.name), ("sender", Bytes.name), ("timestamp", lambda b: b.unpack("q")),
    ("id", Bytes.varint), ("content", None), ("fence", Bytes.varint), ("received", lambda b: b.unpack("q")),
    ("age", Bytes.zigzag), ("age-error", Bytes.varint), ("family", lambda b: FAMILIES[b.take(1)[0]]),
    ("reference", Bytes.varint), ("priority", Bytes.zigzag),
    ("address", lambda b: [b.name() for _ in range(b.varint())]), ("expires", Bytes.varint),
    ("delivery", lambda b: CLASSES[b.take(1)[0]]), ("echo", lambda b: b.take(1) == b"\1"),
    ("receipt", lambda b: b.take(1) == b"\1"), ("context", lambda b: b.take(b.varint()).decode()),
    ("others", lambda b: Bytes(b.take(b.varint())).value()),
]


class Peer:
    """One connection, logged in."""

    def __init__(self, port, user):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=60)
        self.file = self.socket.makefile("rb")
        self.last, self.paths, self.numbers, self.streams = 0, {}, {}, {}
        self.socket.sendall(PREFACE)
        assert self.file.read(6)[:5] == PREFACE[:5]
        self.ask("login", "login", "/", {"name": user, "password": user})

    def send(self, family, name, context, content=None, receipt=False, reference=None):
        self.last += 1
        number = self.numbers.get(context)
        # Bits 1 name, 4 id, 10 family always; the context by number (0) or by path (18).
        bits = 1 << 1 | 1 << 4 | 1 << 10 | (1 << 18 if number is None else 1)
        bits |= (content is not None) << 5 | (reference is not None) << 11 | receipt << 17
        body = b"\0" + varint(bits) + (b"" if number is None else varint(number)) + spelled(name) + varint(self.last)
        body += bytes([FAMILIES.index(family)]) + (b"" if reference is None else varint(reference))
        body += b"\1" * receipt + (varint(len(context)) + context.encode()) * (number is None)
        body += b"" if content is None else packed(content)
        self.socket.sendall(struct.pack(">I", len(body)) + body)
        return self.last

    def hear(self):
        """The next parcel, told, or None at the end; a ping is answered."""
        while len(head := self.file.read(4)) == 4:
            frame = Bytes(self.file.read(struct.unpack(">I", head)[0]))
            kind = frame.take(1)[0]
            parcel = self.chunk(frame) if kind == 1 else self.parcel(frame) if kind == 0 else None
            if parcel:
                return parcel
        return None

    def chunk(self, frame):
        """A piece of a large parcel; the parcel with the last one."""
        stream, flags = frame.varint(), frame.take(1)[0]
        if flags & 4:
            del self.streams[stream]
            return None
        if flags & 1:
            self.streams[stream] = (frame.varint(), bytearray())
        length, data = self.streams[stream]
        data += frame.take(len(frame.data) - frame.at)
        if not flags & 2:
            return None
        del self.streams[stream]
        assert len(data) == length, "all pieces of a parcel"
        whole = Bytes(bytes(data))
        assert whole.take(1) == b"\0", "pieces of a parcel"
        return self.parcel(whole)

    def parcel(self, frame):
        """Reads the slots of a whole parcel."""
        bits, parcel = frame.varint(), {"family": "message"}
        for bit, (slot, read) in enumerate(READERS):
            if bits >> bit & 1 and read:
                parcel[slot] = read(frame)
        if bits >> 5 & 1:
            parcel["content"] = frame.value()
        assert frame.at == len(frame.data)
        if "number" in parcel and "context" in parcel:
            self.paths[parcel["number"]] = parcel["context"]
            self.numbers[parcel["context"]] = parcel["number"]
        elif "number" in parcel:
            parcel["context"] = self.paths[parcel["number"]]
        tell(parcel)
        if (parcel["family"], parcel["name"]) == ("time", "ping"):
            self.send("time", "pong", "/", reference=parcel["id"])
        return parcel

    def ask(self, *request, **options):
        """Sends a request and waits for its answer."""
        number = self.send(*request, **options)
        while (answer := self.hear()).get("reference") != number or answer["family"] == "message":
            pass
        assert answer["family"] == "reply", answer


def tell(parcel):
    """One line of JSON: bytes as their length and hash."""
    def plain(data):
        return {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    print(json.dumps(parcel, default=plain), flush=True)


def main():
    peer = Peer(int(sys.argv[1]), sys.argv[2])
    for context in ("/robot", "/robot/arm", "/camera", "/camera/x"):
        peer.ask("context", "join", context)
    peer.ask("token", "grab", "/robot/token")
    peer.ask("message", "command", "/robot/arm", "move 100 50 200 0 0; grip close", receipt=True)
    while (heard := peer.hear())["name"] != "bye":
        assert heard["family"] != "error", heard
    peer.ask("token", "release", "/robot/token")
    peer.ask("login", "logout", "/")
    while peer.hear():
        pass
    tell({"closed": True})


if __name__ == "__main__":
    main()
