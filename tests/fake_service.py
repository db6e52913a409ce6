"""A service without an engine: it records requests, and sends what a test wants."""

from __future__ import annotations

import threading

from raystream.viewer.messages import Frame


class FakeService:
    def __init__(self):
        self.clients = []
        self.is_closed = False

    @property
    def present(self):
        return [joined for joined in self.clients if not joined.has_left]

    def join(self, send):
        joined = FakeClient(send)
        self.clients.append(joined)
        send({"type": "hello", "version": "0", "limits": {"samples": 64}})
        send({"type": "scene", "name": "fake"})
        send(Frame({"type": "frame", "number": 0}, b"picture"))
        return joined

    def close(self):
        self.is_closed = True


class FakeClient:
    """Echoes messages, reports unknown types, and on "stream" sends forever."""

    def __init__(self, send):
        self.send = send
        self.taken = []
        self.opened = []
        self.left = threading.Event()
        self.thread = None

    @property
    def has_left(self):
        return self.left.is_set()

    def handle(self, message):
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
