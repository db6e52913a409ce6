"""Servers for tests, and a check for leftovers.

Fixtures import everything that needs [view]: without it, each test module says so and skips.
"""

from __future__ import annotations

import tempfile
import threading

import pytest


@pytest.fixture(scope="module")
def temporary(tmp_path_factory):
    """The folder of temporary folders; and servers have small pages.

    Until the module ends: what follows in this process may show the page.
    """
    from raystream.viewer.server import app
    from viewer_home import PAGE

    folder = tmp_path_factory.mktemp("temporary")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tempfile, "tempdir", str(folder))
        patch.setattr(app, "read_page_files", lambda: PAGE)
        yield folder


@pytest.fixture(scope="module")
def shared_home(temporary):
    """One server for all of a module's tests that do not change it."""
    from viewer_home import Home

    home = Home()
    yield home
    home.close()


@pytest.fixture
def no_leaks(temporary):
    """Afterwards there are no more threads, files and folders than before."""
    from viewer_home import count_files, wait_until

    threads, files = threading.active_count(), count_files()
    yield
    assert list(temporary.iterdir()) == []
    wait_until(lambda: threading.active_count() <= threads)
    wait_until(lambda: count_files() <= files)


@pytest.fixture
def make_home(no_leaks):
    """Make servers for one test."""
    from viewer_home import Home

    homes = []

    def make(*arguments, **options):
        homes.append(Home(*arguments, **options))
        return homes[-1]

    yield make
    for home in homes:
        home.close()


@pytest.fixture
def home(shared_home, no_leaks):
    """A server that no other test uses while the test runs."""
    yield shared_home
    shared_home.drop_clients()
