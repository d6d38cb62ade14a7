"""A robot's server, written from the paper's words alone.

It listens on a port of its own choice, which it prints, and then prints a line for each thing that happens:

    port 40123
    connected
    got 06 00100 00100
    closed

On its standard input it takes: `cut` (close the connection), `mute` and `unmute` (do not reply), `say TEXT` (send it),
`flood` (send what is not a reply, without end), `chatter` (send replies to NULLs that nobody sent, without end).
"""

import os
import socket
import sys
import threading

# Controller to robot command values (table 1), and the bytes of each: two digits, and a space and five characters
# for each parameter.
NULL, STATUS, MOTOR, LEDS = "00", "04", "06", "07"
BYTES = {NULL: 2, STATUS: 2, MOTOR: 14, LEDS: 8}
SWITCHES = 37


class Robot:
    def __init__(self):
        self.connection = None
        self.muted = False

    def serve(self):
        # Phase 1: initialisation.
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        tell("port", listener.getsockname()[1])
        while True:
            # Phase 2: listening. Unlike the paper's, it listens again.
            self.connection, _ = listener.accept()
            tell("connected")
            try:
                self.obey(self.connection)
            except OSError:
                pass
            self.connection.close()
            tell("closed")

    def obey(self, connection):
        # Phase 3: commands, as they come.
        pending = b""
        while True:
            received = connection.recv(4096)
            if not received:
                return
            pending += received
            while len(pending) >= 2:
                command = pending[:2].decode("ascii")
                if command not in BYTES:
                    tell("unknown", repr(pending))
                    return
                if len(pending) < BYTES[command]:
                    break
                message, pending = pending[: BYTES[command]], pending[BYTES[command] :]
                tell("got", message.decode("ascii"))
                if self.muted:
                    continue
                if command == NULL:
                    connection.sendall(b"00")
                elif command == STATUS:
                    connection.sendall(b"04 %05d" % SWITCHES)

    def flood(self, words):
        try:
            while True:
                self.connection.sendall(words * 1000)
        except OSError:
            pass

    def take(self, line):
        word, _, rest = line.partition(" ")
        if word == "cut":
            self.connection.shutdown(socket.SHUT_RDWR)
        elif word in ("mute", "unmute"):
            self.muted = word == "mute"
        elif word == "say":
            self.connection.sendall(rest.encode("ascii"))
        elif word in ("flood", "chatter"):
            words = b"there is no such reply; " if word == "flood" else NULL.encode("ascii")
            threading.Thread(target=self.flood, args=(words,), daemon=True).start()
        tell("did", word)


def tell(*words):
    # In one piece, as two threads tell.
    os.write(1, (" ".join(map(str, words)) + "\n").encode("ascii"))


robot = Robot()
threading.Thread(target=robot.serve, daemon=True).start()
for command in sys.stdin:
    robot.take(command.rstrip("\n"))
