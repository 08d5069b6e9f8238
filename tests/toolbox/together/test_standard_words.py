"""No name of the package is one that the field has a standard word for, and no text has a sentence that was replaced.

Names are identifiers of Python and TypeScript, fields, keys of JSON and columns of tables.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import loopshape

PACKAGE = Path(loopshape.__file__).parent
ROOT = PACKAGE.parent

#: nowhere, also as a part of a name: the standard word
PARTS = {
    "wished": "required", "trusted": "valid", "untrusted": "invalid", "strays": "interpolation residual",
    "crowd": "mode cluster", "crowds": "mode clusters", "crowded": "modal cluster", "witness": "eligible fit",
    "foretold": "predictable", "shaken": "disturbed", "begun": "initial point, started", "lifted": "block-wise growth",
    "raced": "tournament", "obstacle": "reason", "followable": "simulation model",
}  # fmt: skip
#: nowhere as a whole name
NAMES = {
    "spare": "slack", "held_by": "recorded_under", "stood": "recorded_under", "judge": "verifier", "judged": "tested",
    "judged_lines": "lines used", "glance": "quick_evaluate", "settle": "tighten_limits", "rough": "coarse, residual",
    "led": "below, extrapolated_below", "led_hz": "extrapolated_below", "contained": "substructures",
    "begin": "initial point", "began": "initial point", "disturbances_of": "disturbed", "met": "equivalent plant",
    "plants_met": "equivalent plants", "gathered": "report_inputs", "arriving": "stream_log", "taking": "acquisition",
    "intake": "acquisition", "reach": "half_width, max_order_design", "says": "message", "said": "message, notes",
    "told": "message, settings, decidable", "followed": "interpolated, simulated_along, tracked",
}  # fmt: skip
#: classes and constants, in their own case
CAPITALS = {
    "Told": "ExperimentSettings", "Settled": "TightenedSolution", "Glanced": "QuickProblem", "Sight": "QuickProblem",
    "Judge": "Verifier", "Found": "SearchResult", "Crowd": "ModeCluster", "Stretch": "band", "Left": "Residual",
    "Raced": "Tournament", "Words": "ConfigTable", "Say": "Response", "Ask": "Request", "Shaped": "ShapingSession",
    "Others": "ClosedLoops", "Pull": "ConstraintMultiplier", "Line": "RequirementResult",
    "Followable": "SimulationModel",
    "Prepared": "PreparedRecording", "SeveralMargins": "Margins", "REACH": "half width", "DOWN": "ratios",
    "ALONG": "half widths", "ASIDE": "lines beside", "WARMTH": "temperature", "KEPT": "draws, points",
    "PLAIN": "Limit.scale", "LOGARITHMS": "Limit.scale",
}  # fmt: skip
#: fields, keys of JSON and columns only: elsewhere these are plain words
FIELDS = {"found": "value", "beyond": "above_band, bound", "held": "recorded_under", "given": "arguments"}
MODULES = {"given", "seen", "held", "growth", "gathered", "arriving", "taking", "intake", "many"}
SENTENCES = (
    "worst found", "rms over the floor", "a contradiction is said", "only you moved", "noise drowns", "foretold",
    "would part the leading", "free disturbance", "ordinary spread", "one can sign", "finite, above zero and rise",
    "judged by nobody", "multisines alike but for their phases", "Distance between frequencies; default", "enough? no",
    "what binds", "What binds", "highest lowest bandwidth", "Starts that are followed", "Stop growing where",
    "that nothing excites", "Do a study to many", "0 for one a core", "-20 is the source's", "meet in each other",
    "and what hums",
    "who answers whom", "Say of each prediction", "summing point: turn it", "freed of the bias", "a FRF", "A FRF",
    "1 FRFs",
)  # fmt: skip
#: what may keep an old name, and why
EXCEPT = {
    "io/write/verdicts.py": "keys of kept verdicts of version 1",
    "io/write/frf_words.py": "keys of FRF files of version 1",
    "toolbox/limits/growth.py": "the growth of a structure, block by block",
    "toolbox/arm/dynamics/closed_loop.py": "quantities held constant over a step",
}
#: read again with the loop of n channels and its one reading
LATER = (
    "loop/margin/", "loop/matrix/", "loop/loop.py",
    "data/requirement/requirements.py", "data/result/", "view/verdict/", "toolbox/pages/report/verdict_parts.py",
)  # fmt: skip


def old_word(name: str, *, is_field: bool = False) -> str:
    """The standard word for a name, "" for one that may stay."""
    bare = name.strip("_")
    part = next((x for x in bare.lower().split("_") if x in PARTS), "")
    return PARTS.get(part) or NAMES.get(bare) or CAPITALS.get(bare) or (FIELDS.get(bare, "") if is_field else "")


def names_of(tree: ast.AST) -> Iterator[tuple[str, bool]]:
    """Names that Python code makes, and whether each is a field or a key."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            yield node.name, False
            yield from (
                (x.target.id, True) for x in node.body if isinstance(x, ast.AnnAssign) and hasattr(x.target, "id")
            )
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.name, node.name == "given"
        elif isinstance(node, ast.arg):
            yield node.arg, False
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id, False
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr, False
        elif isinstance(node, ast.Dict):
            yield from ((x.value, True) for x in node.keys if isinstance(x, ast.Constant) and isinstance(x.value, str))
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "keys":
            yield from ((str(x.value), True) for x in node.args if isinstance(x, ast.Constant))
            yield from ((x.arg, True) for x in node.keywords if x.arg)
        elif isinstance(node, ast.Tuple | ast.List):  # columns of a table
            yield from ((x.value, False) for x in node.elts if isinstance(x, ast.Constant) and isinstance(x.value, str))


def python_finds(source: str) -> set[str]:
    """Old names in Python code, each with its standard word."""
    made = ((name, old_word(name, is_field=is_field)) for name, is_field in names_of(ast.parse(source)))
    return {f"{name}: {word}" for name, word in made if word}


def typescript_finds(source: str) -> set[str]:
    """Old names in TypeScript without its comments and texts."""
    bare = re.sub(
        r"/\*.*?\*/|//[^\n]*|\"(?:\\.|[^\"\\])*\"|'(?:\\.|[^'\\])*'|`(?:\\.|[^`\\])*`", "", source, flags=re.S
    )
    names = {re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name) for name in re.findall(r"[A-Za-z_$][\w$]*", bare)}
    return {f"{name}: {word}" for name in names if (word := old_word(name))}


def sentence_finds(text: str) -> set[str]:
    """Replaced sentences in a text."""
    return {x for x in SENTENCES if re.search(rf"(?<![\w]){re.escape(x)}(?!\w)", text)}


def of_package(*patterns: str) -> list[Path]:
    """The package's own files."""
    return [p for x in patterns for p in sorted(PACKAGE.rglob(x)) if "node_modules" not in p.parts]


def is_left(path: Path) -> bool:
    """Whether a file may keep old names."""
    inside = path.relative_to(PACKAGE).as_posix()
    return inside in EXCEPT or inside.startswith(LATER)


def test_names_are_standard() -> None:
    own = [p for p in of_package("*.py") if not is_left(p)]
    finds = {str(p.relative_to(PACKAGE)): python_finds(p.read_text("utf-8")) for p in own}
    finds |= {p.name: typescript_finds(p.read_text("utf-8")) for p in of_package("*.ts")}
    assert {file: sorted(names) for file, names in finds.items() if names} == {}
    assert [str(p) for p in own if p.stem in MODULES] == []


def test_sentences_are_the_fields() -> None:
    texts = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "docs").rglob("*.py"))]
    texts += [*sorted((ROOT / "examples").rglob("*.toml")), *of_package("*.py", "*.ts")]
    texts = [p for p in texts if not (p.is_relative_to(PACKAGE) and is_left(p))]
    finds = {str(p): sentence_finds(p.read_text("utf-8")) for p in texts if p.exists()}
    assert {file: sorted(found) for file, found in finds.items() if found} == {}


@pytest.mark.parametrize(
    "code",
    [
        "class A:\n    wished: float", "class A:\n    found: float", 'x = {"spare": 1.0}', 'C = ("loop", "trusted")',
        "def judged(x): ...", "def f(shaken): ...", "begun = 1", "class Crowd: ...", "REACH = 1.0", "x.told = 2",
        'IN_JSON = keys("met")', "IN_JSON = keys(wished_std='std')", "_said = []",
    ],
)  # fmt: skip
def test_an_old_name_is_found(code: str) -> None:
    assert len(python_finds(code)) == 1


def test_an_old_name_is_found_in_typescript() -> None:
    assert typescript_finds('const crowd = x; // spare\nconst word = "told";') == {"crowd: mode cluster"}
    assert typescript_finds("function pastCrowd() {}") == {"past_Crowd: mode cluster"}


def test_an_old_sentence_is_found() -> None:
    assert sentence_finds("it writes a FRF and says what binds") == {"a FRF", "what binds"}
    assert sentence_finds("an FRF, data FRF, 11 FRFs") == set()
