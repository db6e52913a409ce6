"""A studio without an engine: it keeps what it is told, and sends what a test wants."""

from __future__ import annotations

import threading

from raystream.viewer.messages import Frame


class FakeStudio:
    def __init__(self):
        self.visitors = []
        self.is_closed = False

    @property
    def present(self):
        return [visitor for visitor in self.visitors if not visitor.has_left]

    def join(self, send):
        visitor = FakeVisitor(send)
        self.visitors.append(visitor)
        send({"type": "hello", "version": "0", "limits": {"samples": 64}})
        send({"type": "scene", "name": "fake"})
        send(Frame({"type": "frame", "number": 0}, b"picture"))
        return visitor

    def close(self):
        self.is_closed = True


class FakeVisitor:
    """Echoes messages; of unknown types it says so, and "stream" makes it send for ever."""

    def __init__(self, send):
        self.send = send
        self.taken = []
        self.opened = []
        self.left = threading.Event()
        self.thread = None

    @property
    def has_left(self):
        return self.left.is_set()

    def take(self, message):
        self.taken.append(message)
        if message["type"] == "stream":
            self.thread = threading.Thread(target=self.stream, args=(message["bytes"],))
            self.thread.start()
        elif message["type"] in ("camera", "pick"):
            self.send({"type": "echo", "message": message})
        else:
            self.send({"type": "error", "message": "unknown type", "about": message["type"]})

    def stream(self, count):
        number = 0
        while not self.left.wait(0.002):
            number += 1
            self.send(Frame({"type": "frame", "number": number}, bytes(count)))

    def open(self, path, name):
        self.opened.append((path, name))
        if name == "bad.obj":
            self.send({"type": "error", "message": f"{path}: is damaged", "about": "open"})
            return
        self.send({"type": "opened", "name": name, "content": path.read_bytes().decode("latin-1")})

    def leave(self):
        self.left.set()
