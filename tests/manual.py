"""README and the manual as the tests read them: pages, commands, blocks of code, links."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"

PAGES = sorted(
    [
        *ROOT.glob("*.md"), *DOCS.glob("*.md"), *DOCS.glob("reference/*.md"), *DOCS.glob("notes/*.md"),
        *ROOT.glob("[!.]*/README.md"),
        ROOT / "trainer/src/trainer/run/pretrained/README.md",
    ]
)  # fmt: skip
PROGRAMS = ("make", "datafactory", "trainer", "python", "python3", "pytest")


@dataclass(frozen=True)
class Command:
    """A command that stands in a page.

    :param page: name of the page, as README.md or docs/start.md
    :param text: as it stands there, on one line, without its comment
    :param in_block: in a block of its own, to be typed as it is; otherwise in the middle of a sentence or table
    """

    page: str
    text: str
    in_block: bool

    @property
    def words(self) -> list[str]:
        """Program and arguments, without the environment's folder."""
        first, *others = shlex.split(self.text)
        return [first.removeprefix(".venv/bin/"), *others]


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def blocks(page: Path, language: str) -> list[str]:
    """The fenced blocks of a language, in their order."""
    text = page.read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def commands(page: Path) -> list[Command]:
    """Every command of a page, in its order of blocks and then of sentences."""
    text = re.sub(r"^```(?!bash|sh|console).*?^```", "", page.read_text(encoding="utf-8"), flags=re.S | re.M)
    indented = "\n".join(line for line in text.splitlines() if line.startswith("    "))
    fenced = "\n".join(re.findall(r"^```(?:bash|sh|console)\n(.*?)^```", text, re.S | re.M))
    found = []
    for line in re.sub(r"\\\n\s*", "", indented + "\n" + fenced).splitlines():
        stripped = re.sub(r"\s+#\s.*", "", line).strip()
        if _is_command(stripped):
            found.append(Command(name_of(page), stripped, in_block=True))
    sentences = "\n".join(line for line in text.splitlines() if not line.startswith("    "))
    for span in re.findall(r"`([^`]+)`", sentences):
        line = " ".join(span.split())
        if _is_command(line) and (line.startswith("make ") or len(line.split()) > 2):
            found.append(Command(name_of(page), line, in_block=False))
    return found


def _is_command(line: str) -> bool:
    program, _, others = line.partition(" ")
    return program.removeprefix(".venv/bin/") in PROGRAMS and bool(others)


def links(page: Path) -> list[str]:
    """Targets of the links and pictures of a page, without those to other machines."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.S | re.M)
    text = "\n".join(line for line in text.splitlines() if not line.startswith("    "))
    return [target for target in re.findall(r"\]\(([^)\s]+)\)", text) if not re.match(r"[a-z]+:", target)]


def anchors(page: Path) -> set[str]:
    """What may follow # in a link to the page."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.S | re.M)
    headings = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}
