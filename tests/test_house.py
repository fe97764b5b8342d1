"""House rules held by reading the source: parameters, module docstrings, names of tests' folders."""

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCE_ROOTS = ("core/wayloom", "services/wayloom_services", "workers/wayloom_workers")
MOST_PARAMETERS = 8
LONGEST_LINE = 132
NO_NOUN_PHRASE = ("What", "Where", "When", "Which", "Who", "Whose", "How", "Why", "Whether", "That", "So", "If")
"""Words that begin a clause instead of a name."""
NO_ROOM = {"service_kit"}
"""Folders of tests that hold helpers."""


def modules() -> Iterator[tuple[str, ast.Module]]:
    """Path from the repository's root, and syntax tree, of every module of the product."""
    for root in SOURCE_ROOTS:
        for file in sorted((ROOT / root).rglob("*.py")):
            yield file.relative_to(ROOT).as_posix(), ast.parse(file.read_text("utf-8"))


def parameter_count(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """The parameters of a function, self and cls not counted; a variadic one counts once."""
    a = function.args
    named = [argument.arg for argument in (*a.posonlyargs, *a.args, *a.kwonlyargs)]
    return len([name for name in named if name not in ("self", "cls")]) + (a.vararg is not None) + (a.kwarg is not None)


def is_command(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Whether all parameters are arguments and options of the command line, which Typer reads from a command's signature."""
    texts = [ast.unparse(argument.annotation) for argument in function.args.args if argument.annotation is not None]
    return len(texts) == parameter_count(function) and all("typer." in text or text.endswith("Option") for text in texts)


def wide_functions(tree: ast.Module, commands: bool = False) -> set[str]:
    """Functions and methods with more than MOST_PARAMETERS; but for commands, where there are any."""
    functions = (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))
    wide = [function for function in functions if parameter_count(function) > MOST_PARAMETERS]
    return {function.name for function in wide if not (commands and is_command(function))}


def docstring_faults(tree: ast.Module) -> list[str]:
    """What is wrong with a module's docstring."""
    lines = (ast.get_docstring(tree) or "").split("\n")
    first = lines[0]
    if not first:
        return ["it has none"]
    faults = {
        "its first line does not end in a full stop": not first.endswith("."),
        "its first line begins with a small letter": first[0].islower(),
        "its first line is no noun phrase": first.split()[0] in NO_NOUN_PHRASE,
        "its first line is too long": len(first) + len('""""""') > LONGEST_LINE,
        "its first line is followed by another without a blank one": len(lines) > 1 and bool(lines[1]),
    }
    return [fault for fault, is_so in faults.items() if is_so]


MODULES = dict(modules())


@pytest.mark.parametrize("path", [path for path in MODULES if "kernels" not in path.split("/")])
def test_no_function_outside_of_the_kernels_has_more_than_eight_parameters(path: str) -> None:
    commands = path.startswith("core/wayloom/cli/")
    assert wide_functions(MODULES[path], commands) == set(), "group the parameters by meaning"


@pytest.mark.parametrize("path", MODULES)
def test_every_module_is_named_by_the_first_line_of_its_docstring(path: str) -> None:
    assert docstring_faults(MODULES[path]) == []


def test_the_folders_of_the_tests_are_those_of_the_source() -> None:
    folders = {file.parent.relative_to(ROOT / "tests").as_posix() for file in (ROOT / "tests").rglob("*.py")} - {"."} - NO_ROOM
    rooms = {"docs", "services", "workers", *(Path(path).parent.as_posix().removeprefix("core/wayloom/") for path in MODULES)}
    assert folders <= rooms


def test_no_two_test_modules_have_the_same_name() -> None:
    names = Counter(file.name for file in (ROOT / "tests").rglob("test_*.py"))
    assert [name for name, count in names.items() if count > 1] == []


def test_the_rules_find_what_they_look_for() -> None:
    wide = ast.parse("class A:\n def f(self, a, b, c, d, e, /, f, *g, h, **i): pass\n def g(self, a, b, c, d, e, f, g, h): pass")
    assert wide_functions(wide, commands=True) == {"f"}
    options = ", ".join(f"o{k}: Annotated[int, typer.Option()]" for k in range(8))
    assert wide_functions(ast.parse(f"def command({options}, config: ConfigOption): pass"), commands=True) == set()
    assert wide_functions(ast.parse(f"def command({options}, config: ConfigOption): pass")) == {"command"}
    assert wide_functions(ast.parse(f"def helper({options}, config: int): pass"), commands=True) == {"helper"}
    assert docstring_faults(ast.parse("x = 1")) == ["it has none"]
    assert docstring_faults(ast.parse('"""Pose graph of one drive."""')) == []
    assert docstring_faults(ast.parse('"""What is kept of a drive"""')) == [
        "its first line does not end in a full stop",
        "its first line is no noun phrase",
    ]
    assert docstring_faults(ast.parse('"""Adjusts poses\nand points."""')) != []
