# SPDX-License-Identifier: Apache-2.0
"""Source metrics: size, complexity, typing, comments and import circles of the packages, as a table.

python tools/checks/source_metrics.py                  the checkout that this file is in
python tools/checks/source_metrics.py BEFORE AFTER     a column for each checkout
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import statistics
import sys
import tokenize
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

PACKAGES = ("stripe_newton", "kernels/stripe_kernels", "tasks/stripe_tasks")


@dataclass
class Imports:
    """Imports of a module, by the time at which they run."""

    loading: set[str] = field(default_factory=set)
    """Imports that run while it is loaded."""
    calling: set[str] = field(default_factory=set)
    """Imports that run when one of its functions is called."""
    typing: set[str] = field(default_factory=set)
    """Imports for type checkers alone."""


def source_files(root: Path) -> dict[str, Path]:
    """Files of the packages by module name."""
    found = {}
    for package in PACKAGES:
        folder = root / package
        for path in sorted(folder.rglob("*.py")):
            parts = path.relative_to(folder.parent).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def functions(tree: ast.AST) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    return (n for n in ast.walk(tree) if isinstance(n, (ast.FunctionDef, ast.AsyncFunctionDef)))


def quantile(values: list[int], share: float) -> int:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def comment_lines(source: str) -> int:
    """Number of lines with a comment; the licence line and orders to tools do not count."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    orders = re.compile(r"#\s*(SPDX|noqa|type:|fmt:|pragma)")
    return len({t.start[0] for t in tokens if t.type == tokenize.COMMENT and not orders.match(t.string)})


def read_imports(name: str, path: Path, tree: ast.AST) -> Imports:
    """Imports of a module, absolute; ``from a import b`` counts as ``a`` and ``a.b``."""
    found = Imports()

    def targets(node: ast.Import | ast.ImportFrom) -> Iterator[str]:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
            return
        base = node.module or ""
        if node.level:
            above = name.split(".")
            above = above[: len(above) - node.level + (path.name == "__init__.py")]
            base = ".".join([*above, base] if base else above)
        yield base
        yield from (f"{base}.{alias.name}" for alias in node.names)

    def visit(node: ast.AST, into: set[str]) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, (ast.Import, ast.ImportFrom)):
                into.update(targets(child))
            elif isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)):
                visit(child, found.calling if into is found.loading else into)
            elif isinstance(child, ast.If) and ast.unparse(child.test).endswith("TYPE_CHECKING"):
                visit(child, found.typing)
            else:
                visit(child, into)

    visit(tree, found.loading)
    return found


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Groups of modules that import each other (strongly connected components of two or more; Tarjan 1972)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    groups: list[list[str]] = []

    def connect(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for target in graph[node]:
            if target not in index:
                connect(target)
                low[node] = min(low[node], low[target])
            elif target in stack:
                low[node] = min(low[node], index[target])
        if low[node] == index[node]:
            group = []
            while not group or group[-1] != node:
                group.append(stack.pop())
            if len(group) > 1:
                groups.append(sorted(group))

    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(10_000)
    for node in graph:
        if node not in index:
            connect(node)
    sys.setrecursionlimit(limit)
    return sorted(groups, key=len, reverse=True)


def complexity(function: ast.AST) -> int:
    """Cyclomatic complexity (McCabe 1976), counted as radon does: boolean operators and comprehensions are branches."""
    count = 1
    todo = list(ast.iter_child_nodes(function))
    while todo:
        node = todo.pop()
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            continue  # counted by itself
        if isinstance(node, (ast.If, ast.IfExp, ast.For, ast.While, ast.ExceptHandler, ast.Assert, ast.match_case)):
            count += 1
        elif isinstance(node, ast.BoolOp):
            count += len(node.values) - 1
        elif isinstance(node, ast.comprehension):
            count += 1 + len(node.ifs)
        todo.extend(ast.iter_child_nodes(node))
    return count


def metrics(root: Path) -> dict[str, str]:
    """All figures of a checkout by their title."""
    files = source_files(root)
    sources = {name: path.read_text() for name, path in files.items()}
    trees = {name: ast.parse(source) for name, source in sources.items()}
    lengths = [source.count("\n") for source in sources.values()]
    total = sum(lengths)
    spans = [f.end_lineno - f.lineno + 1 for tree in trees.values() for f in functions(tree)]
    any_lines = (line for source in sources.values() for line in source.splitlines() if "import" not in line)
    number_of_any = sum(len(re.findall(r"\bAny\b", line)) for line in any_lines)
    comments = sum(map(comment_lines, sources.values()))
    complex_ = [complexity(f) for tree in trees.values() for f in functions(tree)]
    imported = {name: read_imports(name, files[name], tree) for name, tree in trees.items()}

    def groups(*kinds: str) -> str:
        def known(name: str) -> set[str]:
            every = set().union(*(getattr(imported[name], kind) for kind in kinds))
            return {t for t in every if t in files and not name.startswith(f"{t}.")} - {name}

        found = circles({name: known(name) for name in files})
        return f"{len(found)} ({sum(map(len, found))} modules)" if found else "0"

    return {
        "files": str(len(files)),
        "lines": f"{total:,}",
        "lines of a file: median / p90 / longest": row(lengths),
        "lines of a function: median / p90 / longest": row(spans),
        "functions over 60 lines": str(sum(s > 60 for s in spans)),
        "functions of complexity over 10 / over 20 / worst": (
            f"{sum(c > 10 for c in complex_)} / {sum(c > 20 for c in complex_)} / {max(complex_)}"
        ),
        "`Any` in 1000 lines": f"{1000 * number_of_any / total:.1f}",
        "lines with a comment": f"{100 * comments / total:.1f} %",
        "import circles at load": groups("loading"),
        "import circles with imports in functions": groups("loading", "calling"),
        "import circles with those for types": groups("loading", "calling", "typing"),
    }


def row(values: Iterable[int]) -> str:
    numbers = list(values)
    return f"{statistics.median(numbers):g} / {quantile(numbers, 0.9)} / {max(numbers)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkouts", nargs="*", type=Path, default=[Path(__file__).parents[2]])
    roots = parser.parse_args().checkouts
    columns = [metrics(root.resolve()) for root in roots]
    print(f"| | {' | '.join(root.resolve().name for root in roots)} |")
    print(f"|---|{'---|' * len(roots)}")
    for title in columns[0]:
        print(f"| {title} | {' | '.join(column[title] for column in columns)} |")


if __name__ == "__main__":
    main()
