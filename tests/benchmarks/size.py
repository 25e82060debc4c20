"""``make size``: how much there is to carry. Lines and files of source and tests, functions of many parameters."""

import ast
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ("datafactory", "trainer", "shared", "scenes", "examples")
MOST_PARAMETERS = 8


def tracked(*folders: str) -> list[Path]:
    """Files of Python that git knows below these folders."""
    command = ["git", "-C", str(ROOT), "ls-files", "--", *(f"{folder}/**.py" for folder in folders)]
    return [ROOT / name for name in subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()]


def lines(files: list[Path]) -> int:
    """Of all files together."""
    return sum(len(path.read_text().splitlines()) for path in files)


def wide_functions(files: list[Path]) -> list[str]:
    """Functions with more than eight parameters, with their numbers, the widest first."""
    found = []
    for path in files:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef):
                named = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
                count = sum(item.arg not in ("self", "cls") for item in named)
                if count > MOST_PARAMETERS:
                    found.append((-count, f"{path.relative_to(ROOT)}:{node.name} {count}"))
    return [line for _, line in sorted(found)]


def main() -> None:
    source, tests = tracked(*SOURCE), tracked("tests")
    wide = wide_functions([path for path in source if "cli" not in path.parts])
    print(f"lines of source                                      {lines(source):6}")
    print(f"files of source                                      {len(source):6}")
    print(f"functions of more than {MOST_PARAMETERS} parameters, without cli     {len(wide):6}")
    for line in wide:
        print(f"    {line}")
    print(f"lines of tests, benchmarks among them                {lines(tests):6}")
    print(f"files of tests                                       {len(tests):6}")


if __name__ == "__main__":
    main()
