"""Where no Chromium is to be had, one line says why, and nothing is left that could be taken for one."""

import platform

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
