"""The viewer's server: one page, one websocket, one place for uploads, and who may use them."""
