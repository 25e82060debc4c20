"""Array shapes in the signatures of ``shared``: every public function states them, and under test they hold."""

import ast
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import TypeCheckError

import shared
from shared.physics.wedge import WedgeGeometry
from shared.radar import Radar
from shared.signal import round_trip_delays

ROOT = Path(next(iter(shared.__path__)))
BARE = ("NDArray", "ndarray")


def public_functions(tree: ast.Module) -> Iterator[ast.FunctionDef]:
    for node in tree.body:
        members = [node, *node.body] if isinstance(node, ast.ClassDef) else [node]
        yield from (item for item in members if isinstance(item, ast.FunctionDef) and item.name[0] != "_")


def has_bare_array(annotation: ast.expr) -> bool:
    """Whether an array stands in it that is not the first part of a jaxtyping type, ``Float[np.ndarray, "..."]``."""
    if isinstance(annotation, ast.Subscript) and isinstance(annotation.slice, ast.Tuple):
        parts = annotation.slice.elts
        if isinstance(parts[-1], ast.Constant) and isinstance(parts[-1].value, str):
            return False
    if isinstance(annotation, ast.Name | ast.Attribute):
        return ast.unparse(annotation).rpartition(".")[2] in BARE
    return any(has_bare_array(child) for child in ast.iter_child_nodes(annotation) if isinstance(child, ast.expr))


@pytest.mark.parametrize("path", sorted(ROOT.rglob("*.py")), ids=lambda path: path.relative_to(ROOT).as_posix())
def test_public_functions_state_the_shapes_of_their_arrays(path: Path) -> None:
    for function in public_functions(ast.parse(path.read_text(encoding="utf-8"))):
        arguments = [*function.args.args, *function.args.kwonlyargs]
        annotations = [item.annotation for item in arguments] + [function.returns]
        bare = [ast.unparse(item) for item in annotations if item is not None and has_bare_array(item)]
        assert not bare, f"{path.name}: {function.name}"


def test_a_wrong_shape_or_dtype_is_found_under_test() -> None:
    radar = Radar()
    with pytest.raises(TypeCheckError, match="position"):
        round_trip_delays(radar, np.zeros(2), np.zeros(3))
    with pytest.raises(TypeCheckError, match="sin_beta"):
        WedgeGeometry(np.full(2, 1.5), np.ones(2), np.ones(2), np.ones(2), np.ones(2), sin_beta=np.ones(3))
