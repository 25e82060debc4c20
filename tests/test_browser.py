"""Where no Chromium is to be had, one line says why, and nothing is left that could be taken for one."""

import platform
from types import SimpleNamespace

import browser
import pytest

NPM_SAYS = "echo 'npm warn slow' >&2; echo 'npm error code ENOTFOUND' >&2; exit 1"


@pytest.mark.parametrize(
    ("machine", "npm", "said"),
    [
        ("aarch64", None, "is for Linux x86_64, this is Linux aarch64"),
        ("x86_64", None, "npm, which fetches it, is neither on the PATH nor beside this Python"),
        ("x86_64", NPM_SAYS, f"{browser.PACKAGE}@{browser.VERSION}: npm error code ENOTFOUND"),
        ("x86_64", "echo other > package.tgz", f"expected {browser.INTEGRITY}"),
    ],
)
def test_no_chromium_is_one_line(machine, npm, said, tmp_path, monkeypatch):
    programs = tmp_path / "programs"
    programs.mkdir()
    monkeypatch.setenv("PATH", str(programs))
    monkeypatch.setattr(browser, "FOLDER", tmp_path / "browser")
    monkeypatch.setattr(platform, "system", lambda: "Linux")
    monkeypatch.setattr(platform, "machine", lambda: machine)
    if npm:
        (programs / "npm").write_text(f"#!/bin/sh\n{npm}\n")
        (programs / "npm").chmod(0o755)
    with pytest.raises(browser.NoBrowser) as caught:
        browser.fetch_browser()
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert browser.installed_browser() is None
    assert list(tmp_path.glob("browser/*")) == []


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
