"""A base station written from the paper's words alone: standard library, one connection, frames of fixed length.

Arguments: the robot's port. It prints what it sees, a line each, for the test to compare.
"""
import socket
import sys

NULL, STATUS, MOTOR, LEDS = 0, 4, 6, 7
HOST, PORT = "127.0.0.1", int(sys.argv[1])


def connect():
    station = socket.create_connection((HOST, PORT), timeout=20)
    station.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return station


def read(station, length):
    text = b""
    while len(text) < length:
        piece = station.recv(length - len(text))
        if not piece:
            return "closed after " + text.decode()
        text += piece
    return text.decode()


station = connect()
# A command without parameters, and its reply.
station.sendall(b"%02d" % NULL)
print("null:", read(station, 2))
# Commands that come together, and one that comes in pieces.
station.sendall(b"%02d %05d %05d%02d %05d%02d" % (MOTOR, 100, 100, LEDS, 5, STATUS))
status = read(station, 8)
print("status:", status[:3], "moving" if int(status[3:]) & 16 else "standing")
for piece in (b"0", b"6 000", b"50 -00", b"50", b"0", b"4"):
    station.sendall(piece)
print("spinning:", "moving" if int(read(station, 8)[3:]) & 16 else "standing")
# A second base station is told by whom the robot is held, and closed.
second = connect()
print("second:", read(second, 26), "then", read(second, 1))
second.close()
# What nobody knows is skipped.
station.sendall(b"55 00001 00002" + b"junk " + b"%02d %05d %05d%02d" % (MOTOR, 0, 0, STATUS))
print("stopped:", "moving" if int(read(station, 8)[3:]) & 16 else "standing")
# It listens again when its base station is gone.
station.close()
third = connect()
third.sendall(b"%02d" % NULL)
print("again:", read(third, 2))
