"""Does the house stay as small as it was? Counts of house.toml, none of which may grow.

python .ci/house.py          1 where a number grew, with its reason asked for beside it in house.toml
python .ci/house.py --write  lowers the numbers that fell
"""

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
NUMBERS = Path(__file__).with_name("house.toml")
PACKAGE = ROOT / "loopshape"
DOZEN = 12
VERBS = re.compile(r"loopshape\.(core|data|identify|loop|design|io)\b")


def modules(folder: Path) -> list[Path]:
    """Python files of the package below a folder."""
    return [p for p in sorted(folder.rglob("*.py")) if "node_modules" not in p.parts]


def imports(path: Path) -> Iterator[str]:
    """Modules of ours that a file imports, those for types alone left out."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    typed = {id(n) for x in ast.walk(tree) if isinstance(x, ast.If) and "TYPE_CHECKING" in ast.dump(x.test)
             for part in x.body for n in ast.walk(part)}  # fmt: skip
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and id(node) not in typed and (node.module or "").startswith("loopshape"):
            yield str(node.module)


def from_another_room(path: Path) -> list[str]:
    """Inner modules that a test imports from another room than its own: `loopshape.<room>`, `loopshape.toolbox.<room>`.

    One for each statement `from loopshape.<...> import ...` in the file; `import loopshape as ls` is the front door.
    A test's rooms are the folders that it lies in (tests/truth/loop, tests/toolbox/arm); that of pictures is view.
    """
    own = {"view" if part == "pictures" else part for part in path.relative_to(ROOT).parts}
    inner = [name for name in imports(path) if "." in name]
    return [name for name in inner if name.removeprefix("loopshape.").removeprefix("toolbox.").split(".")[0] not in own]


def counted() -> dict[str, int]:
    """The numbers of today."""
    bench = [p for p in modules(PACKAGE) if "toolbox" not in p.relative_to(PACKAGE).parts]
    pure = [p for p in bench if p.relative_to(PACKAGE).parts[0] in ("core", "data", "identify", "loop", "design")]
    folders = [p for top in (PACKAGE, ROOT / "tests") for p in (top, *top.rglob("*")) if p.is_dir()]
    folders = [p for p in folders if not {"node_modules", "__pycache__"} & set(p.parts)]
    full = [p for p in folders if sum(q.suffix in (".py", ".ts") for q in p.iterdir()) > DOZEN]
    inner = [name for p in modules(PACKAGE / "cli") for name in imports(p) if VERBS.match(name)]
    pairs = {
        (one.relative_to(PACKAGE).parts[1], name.split(".")[2])
        for one in modules(PACKAGE / "toolbox")
        for name in imports(one)
        if name.startswith("loopshape.toolbox.")
    }
    crossing = [name for p in bench for name in imports(p) if name.startswith("loopshape.toolbox")]

    def lines(paths: list[Path]) -> int:
        return sum(len(p.read_text(encoding="utf-8").splitlines()) for p in paths)

    import loopshape

    return {
        "bench_modules": len(bench),
        "bench_lines": lines(bench),
        "pure_lines": lines(pure),
        "package_modules": len(modules(PACKAGE)),
        "package_lines": lines(modules(PACKAGE)),
        "folders_above_a_dozen": len(full),
        "public_names": len(dir(loopshape)) - 1,
        "imports_of_cli_below_verbs": len(inner),
        "imports_over_the_wall": len(crossing),
        "pairs_of_toolboxes": sum(one != other for one, other in pairs),
        "inner_imports_of_tests": sum(len(from_another_room(p)) for p in modules(ROOT / "tests")),
    }


def main() -> int:
    """Compare, or write what fell."""
    kept, now = tomllib.loads(NUMBERS.read_text(encoding="utf-8")), counted()
    for name, value in now.items():
        print(f"{name:28} {value:6}  (at most {kept.get(name, 0)})")
    grown = [name for name, value in now.items() if value > kept.get(name, 0)]
    if "--write" in sys.argv:
        text = NUMBERS.read_text(encoding="utf-8")
        for name, value in now.items():
            text = re.sub(
                rf"^{name} = (\d+)", lambda m, v=value: m[0].replace(m[1], str(min(v, int(m[1])))), text, flags=re.M
            )
        NUMBERS.write_text(text, encoding="utf-8")
    for name in grown:
        print(f"{name} grew: make it smaller, or raise it in .ci/house.toml with the reason beside it", file=sys.stderr)
    return bool(grown)


if __name__ == "__main__":
    raise SystemExit(main())
