import raystream as rs
from raystream import streams


def test_the_room_is_in_the_package():
    assert rs.streams is streams
    assert "streams" in dir(rs)
    for name in streams.__all__:
        assert hasattr(streams, name)
