"""The outbox: no more pictures are under way than a page has shown."""

from __future__ import annotations

import numpy as np
import pytest

from raystream.viewer.messages import Frame, MessageError
from raystream.viewer.outbox import Outbox
from raystream.viewer.settings import Look
from raystream.viewer.view import Shot


class Encoder:
    """Encodes when it is told, and not before."""

    def __init__(self):
        self.waiting = []

    def encode(self, encode, header, done, failed):
        self.waiting.append((encode, header, done, failed))

    def work(self, error=None):
        while self.waiting:
            encode, header, done, failed = self.waiting.pop(0)
            if error is None:
                done(Frame(header, encode()))
            else:
                failed(error)


@pytest.fixture
def sent():
    return []


@pytest.fixture
def encoder():
    return Encoder()


@pytest.fixture
def outbox(sent, encoder):
    return Outbox(sent.append, encoder, lambda: None, lambda: None)


def shot(name):
    return Shot(
        lambda: (np.zeros((2, 2, 3), np.float32), Look(1.0, "linear", None)),
        {"name": name, "moving": True},
    )


def names(sent):
    return [frame.header["name"] for frame in sent]


def test_a_third_picture_waits_until_the_first_was_shown(outbox, encoder, sent):
    for name in "abc":
        outbox.put(shot(name), may_drop=False)
        encoder.work()
    assert names(sent) == ["a", "b"]
    assert not outbox.has_room
    outbox.acknowledge(1)
    encoder.work()
    assert names(sent) == ["a", "b", "c"]
    assert [frame.header["number"] for frame in sent] == [1, 2, 3]
    with pytest.raises(MessageError, match="3 is the last one sent"):
        outbox.acknowledge(4)


def test_of_pictures_that_wait_the_last_is_sent(outbox, encoder, sent):
    outbox.put(shot("a"), may_drop=False)
    outbox.put(shot("b"), may_drop=False)
    outbox.put(shot("c"), may_drop=False)
    outbox.put(shot("d"), may_drop=True)  # not instead of one that has to be sent
    encoder.work()
    assert names(sent) == ["a", "c"]


def test_a_picture_that_could_not_be_encoded_keeps_no_place(outbox, encoder, sent):
    for name in "abc":
        outbox.put(shot(name), may_drop=False)
        encoder.work(ValueError("too large"))
    assert [message["about"] for message in sent] == ["frame"] * 3
    assert outbox.has_room


def test_nothing_is_sent_after_the_end(outbox, encoder, sent):
    outbox.put(shot("a"), may_drop=False)
    outbox.close()
    encoder.work()
    outbox.put(shot("b"), may_drop=False)
    encoder.work()
    assert sent == []
