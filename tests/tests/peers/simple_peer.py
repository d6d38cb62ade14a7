"""A peer that speaks the XML form of docs/PROTOCOL.md, with nothing but a socket.

    simple_peer.py PORT USER

It logs in (the password is the user's name), joins the robot's and the camera's channels, takes the robot's
token, sends one command with a receipt, and tells on standard output, one JSON line each, what it hears: replies,
events, messages with their binary parts. It answers pings, and logs out when it hears the message `bye`.
"""

import base64
import hashlib
import json
import re
import socket
import sys
import xml.etree.ElementTree as xml
from xml.sax.saxutils import escape

LIMIT = 8 * 1024 * 1024


class Closed(Exception):
    """The hub has closed the connection."""


class Stream:
    """Exactly so many bytes, or up to a line end."""

    def __init__(self, port):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=60)
        self.buffer = b""

    def more(self):
        received = self.socket.recv(65536)
        if not received:
            raise Closed
        self.buffer += received

    def line(self):
        while b"\r\n" not in self.buffer:
            self.more()
        line, self.buffer = self.buffer.split(b"\r\n", 1)
        return line.decode("ascii")

    def exactly(self, count):
        while len(self.buffer) < count:
            self.more()
        data, self.buffer = self.buffer[:count], self.buffer[count:]
        return data


def headers(lines):
    """Header lines as a dictionary, names in lower case."""
    found = {}
    for line in lines:
        name, value = line.split(":", 1)
        name = name.lower()
        assert name.startswith("content-") and name not in found, line
        found[name] = value.strip()
    return found


def entity(stream):
    """The next entity: its XML, and its parts by their ids."""
    lines = []
    while line := stream.line():
        lines.append(line)
    head = headers(lines)
    length = int(head["content-length"])
    assert 0 < length <= LIMIT
    body = stream.exactly(length)
    if head["content-type"].startswith("application/xml"):
        return body, {}
    assert head["content-type"].startswith("multipart/related"), head
    boundary = re.search(r'boundary="?([^";]+)', head["content-type"]).group(1).encode()
    sections = (b"\r\n" + body).split(b"\r\n--" + boundary)
    assert sections[0] == b"" and sections[-1] in (b"--", b"--\r\n")
    document, parts = None, {}
    for section in sections[1:-1]:
        head, data = section.split(b"\r\n\r\n", 1)
        fields = headers(head.decode("ascii").split("\r\n")[1:])
        if document is None:
            document = data
        else:
            parts[fields["content-id"].strip("<>")] = data
    return document, parts


SLOTS = {"id": "int", "reference": "int", "fence": "int", "priority": "int", "expires": "int", "age": "int",
         "age-error": "int", "timestamp": "time", "received": "time", "address": "list", "echo": "boolean",
         "receipt": "boolean"}


def value(element, parts, default="string"):
    """The value of an element."""
    kind, text = element.get("type", default), element.text or ""
    if kind == "map":
        return slots(element, parts)
    if kind == "list":
        return [value(item, parts) for item in element]
    if kind == "binary":
        if element.get("encoding") == "base64":
            return base64.b64decode(text)
        return parts[element.find("cid").text]
    simple = {"null": lambda text: None, "boolean": lambda text: text == "true", "int": int, "double": float}
    return simple.get(kind, str)(text)


def slots(element, parts, known=()):
    """The members of a map or the slots of a parcel."""
    key = lambda child: child.get("key") if child.tag == "slot" else child.tag
    return {key(child): value(child, parts, dict(known).get(key(child), "string")) for child in element}


class Peer:
    """One connection, logged in."""

    def __init__(self, port, user):
        self.stream = Stream(port)
        self.last = 0
        secret = f"<name>{escape(user)}</name><password>{escape(user)}</password>"
        self.ask("login", "login", "/", f'<content type="map">{secret}</content>')

    def send(self, family, name, context, rest=""):
        self.last += 1
        body = (f"<parcel><family>{family}</family><name>{name}</name><id>{self.last}</id>"
                f"<context>{context}</context>{rest}</parcel>").encode()
        head = f"Content-Type: application/xml; charset=utf-8\r\nContent-Length: {len(body)}\r\n\r\n"
        self.stream.socket.sendall(head.encode() + body)
        return self.last

    def hear(self):
        """The next parcel; it is told, and a ping is answered."""
        document, parts = entity(self.stream)
        parcel = slots(xml.fromstring(document.decode()), parts, SLOTS)
        tell(parcel)
        if (parcel["family"], parcel["name"]) == ("time", "ping"):
            self.send("time", "pong", "/", f"<reference>{parcel['id']}</reference>")
        return parcel

    def ask(self, family, name, context, rest=""):
        """Sends a request and waits for its answer."""
        number = self.send(family, name, context, rest)
        while (answer := self.hear()).get("reference") != number or answer["family"] == "message":
            pass
        assert answer["family"] == "reply", answer
        return answer


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
    script = escape("move 100 50 200 0 0; grip close")
    peer.ask("message", "command", "/robot/arm", f"<receipt>true</receipt><content>{script}</content>")
    while (heard := peer.hear()).get("name") != "bye":
        assert heard["family"] != "error", heard
    peer.ask("token", "release", "/robot/token")
    peer.ask("login", "logout", "/")
    try:
        while peer.hear():
            pass
    except Closed:
        tell({"closed": True})


if __name__ == "__main__":
    main()
