"""Where no Chromium is to be had, one line says why, and nothing is left that could be taken for one."""

import platform
from types import SimpleNamespace

import browser
import pytest


@pytest.fixture
def npm(tmp_path, monkeypatch):
    """Puts a program named npm on the PATH, alone, and the browser's folder somewhere new."""
    programs = tmp_path / "programs"
    programs.mkdir()
    monkeypatch.setenv("PATH", str(programs))
    monkeypatch.setattr(browser, "FOLDER", tmp_path / "browser")
    monkeypatch.setattr(platform, "system", lambda: "Linux")
    monkeypatch.setattr(platform, "machine", lambda: "x86_64")

    def put(script):
        (programs / "npm").write_text(f"#!/bin/sh\n{script}\n")
        (programs / "npm").chmod(0o755)

    yield put
    assert browser.installed_browser() is None
    assert list(tmp_path.glob("browser/*")) == []


def refusal():
    with pytest.raises(browser.NoBrowser) as caught:
        browser.fetch_browser()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_another_platform(npm, monkeypatch):
    monkeypatch.setattr(platform, "machine", lambda: "aarch64")
    assert "is for Linux x86_64, this is Linux aarch64" in refusal()


def test_no_npm(npm):
    assert "npm, which fetches it, is neither on the PATH nor beside this Python" in refusal()


def test_no_network(npm):
    npm("echo 'npm warn slow' >&2; echo 'npm error code ENOTFOUND' >&2; echo 'npm error more' >&2; exit 1")
    assert refusal().endswith(f"{browser.PACKAGE}@{browser.VERSION}: npm error code ENOTFOUND")


def test_other_bytes_than_those_pinned(npm):
    npm("echo other > package.tgz")
    assert f"expected {browser.INTEGRITY}" in refusal()


def test_the_path_comes_first(npm, tmp_path, monkeypatch):
    (tmp_path / "browser" / browser.VERSION).mkdir(parents=True)
    unpacked = browser.installed_browser()
    assert unpacked is not None
    assert unpacked.program == str(tmp_path / "browser" / browser.VERSION / "chromium")
    assert unpacked.environment
    other = tmp_path / "other"
    other.mkdir()
    (other / "chromium").write_text("")
    (other / "chromium").chmod(0o755)
    with monkeypatch.context() as patch:
        patch.setenv("PATH", str(other))
        assert browser.installed_browser() == browser.Browser(str(other / "chromium"), {})
    (tmp_path / "browser" / browser.VERSION).rmdir()


class TargetClosedError(Exception):
    """As playwright names what a browser says that dies as it starts."""


@pytest.mark.parametrize(
    ("deaths", "error", "starts"),
    [(0, TargetClosedError, 1), (2, TargetClosedError, 3), (3, TargetClosedError, 3), (1, TimeoutError, 1)],
)
def test_a_browser_that_dies_as_it_starts_is_started_again(deaths, error, starts):
    left, calls = [error] * deaths, []

    def launch(**settings):
        calls.append(settings)
        if left:
            raise left.pop()
        return "browser"

    driver = SimpleNamespace(chromium=SimpleNamespace(launch=launch))
    chromium = browser.Browser("/somewhere/chromium", {"FONTCONFIG_FILE": "own"})
    if starts > deaths:
        assert chromium.launched(driver, ["--disable-gpu"]) == "browser"
    else:
        with pytest.raises(error):
            chromium.launched(driver, ["--disable-gpu"])
    assert len(calls) == starts
    assert calls[0]["executable_path"] == "/somewhere/chromium"
    assert calls[0]["env"]["FONTCONFIG_FILE"] == "own"
    assert calls[0]["args"] == ["--disable-gpu"]
