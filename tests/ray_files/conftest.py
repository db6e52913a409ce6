"""Fixtures for tests of queries of stores."""

from __future__ import annotations

import os

import pytest

import raystream as rs


@pytest.fixture(autouse=True)
def no_waiting_for_the_disk(monkeypatch):
    """Nothing here makes the machine go down; a process may be killed without it."""
    monkeypatch.setattr(os, "fsync", lambda handle: None)


@pytest.fixture(scope="session")
def tracer():
    return rs.Tracer(rs.load("cornell"))
