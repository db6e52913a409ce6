"""The viewer's server: one page, one websocket, one upload route, and access control."""
