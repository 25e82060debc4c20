"""What was measured once and need not be again."""

from __future__ import annotations

from pathlib import Path

import pytest

from datafactory.accuracy.cache import cached, user_cache
from datafactory.accuracy.prices import Price, Prices

PRICES = Prices(prices=(Price(knob="rays", value=1.0, power=(0.1,), bias=(1.0,), paths=7.0),))


def test_a_damaged_cache_is_measured_again(tmp_path: Path) -> None:
    said: list[str] = []
    paths: list[Path] = []

    def measure(path: Path) -> Prices:
        paths.append(path)
        return PRICES

    for _ in range(2):
        assert cached(tmp_path, {"scene": "a"}, Prices, measure, said.append) == PRICES
    assert len(paths) == 1
    paths[0].write_text("{")
    assert cached(tmp_path, {"scene": "a"}, Prices, measure, said.append) == PRICES
    assert len(paths) == 2
    assert len(said) == 1
    cached(tmp_path, {"scene": "b"}, Prices, measure, said.append)
    assert paths[2] != paths[0]


def test_the_cache_follows_the_user(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert user_cache().is_relative_to(tmp_path)
