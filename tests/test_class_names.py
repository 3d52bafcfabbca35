"""One name, one meaning: no two classes of the product share a name."""

import ast
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parent.parent


def test_no_two_classes_have_one_name():
    files = [*(ROOT / "leactl").rglob("*.py"), *(ROOT / "plugins" / "leactl_plugins").rglob("*.py")]
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in files]
    names = Counter(node.name for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
    assert [name for name, count in names.items() if count > 1] == []
