"""The frame sender limits the frames in flight to those that a page acknowledges."""

from __future__ import annotations

import numpy as np
import pytest

from raystream.viewer.frame_renderer import RenderedFrame
from raystream.viewer.frame_sender import FrameSender
from raystream.viewer.messages import Frame, MessageError
from raystream.viewer.settings import DisplaySettings


class Encoder:
    """Encodes on request only."""

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
def sender(sent, encoder):
    return FrameSender(sent.append, encoder, lambda: None, lambda: None)


def shot(name):
    return RenderedFrame(
        lambda: (np.zeros((2, 2, 3), np.float32), DisplaySettings(1.0, "linear", None)),
        {"name": name, "moving": True},
    )


def names(sent):
    return [frame.header["name"] for frame in sent]


def test_a_third_picture_waits_until_the_first_was_shown(sender, encoder, sent):
    for name in "abc":
        sender.put(shot(name), may_drop=False)
        encoder.work()
    assert names(sent) == ["a", "b"]
    assert not sender.has_room
    sender.acknowledge(1)
    encoder.work()
    assert names(sent) == ["a", "b", "c"]
    assert [frame.header["number"] for frame in sent] == [1, 2, 3]
    with pytest.raises(MessageError, match="3 is the last one sent"):
        sender.acknowledge(4)


def test_of_pictures_that_wait_the_last_is_sent(sender, encoder, sent):
    sender.put(shot("a"), may_drop=False)
    sender.put(shot("b"), may_drop=False)
    sender.put(shot("c"), may_drop=False)
    sender.put(shot("d"), may_drop=True)  # not instead of one that has to be sent
    encoder.work()
    assert names(sent) == ["a", "c"]


def test_a_picture_that_could_not_be_encoded_keeps_no_place(sender, encoder, sent):
    for name in "abc":
        sender.put(shot(name), may_drop=False)
        encoder.work(ValueError("too large"))
    assert [message["about"] for message in sent] == ["frame"] * 3
    assert sender.has_room


def test_nothing_is_sent_after_the_end(sender, encoder, sent):
    sender.put(shot("a"), may_drop=False)
    sender.close()
    encoder.work()
    sender.put(shot("b"), may_drop=False)
    encoder.work()
    assert sent == []
