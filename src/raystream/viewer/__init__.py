"""The viewer: interactive progressive rendering in a browser."""

from raystream.viewer.client import Client
from raystream.viewer.messages import Frame, Send
from raystream.viewer.render_service import RenderService

__all__ = ["Client", "Frame", "RenderService", "Send"]
