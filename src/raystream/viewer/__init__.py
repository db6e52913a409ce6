"""The viewer: a scene that renders itself while people look around in it, in a browser."""

from raystream.viewer.messages import Frame, Send
from raystream.viewer.studio import Studio
from raystream.viewer.visitor import Visitor

__all__ = ["Frame", "Send", "Studio", "Visitor"]
