"""Refuse, before and after flattening, what the translator does not support or the compiler may drop."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from orchestrator.base.errors import BuildError

from .classes import ModelicaClass, used_classes
from .lexer import Token
from .sources import SourceTree

_WHEN = "write it as an if-expression of continuous variables, or move it to a Python FMU"
_KEYWORDS = {
    "when": _WHEN,
    "elsewhen": _WHEN,
    "algorithm": "write equations instead",
    "stream": "use flow variables only",
    "expandable": "declare the connector's variables",
}
_EVENTS = "discrete-time behaviour belongs in a Python FMU"
_CALLS = {
    "reinit": "a state that jumps belongs in a Python FMU",
    "terminate": "stop from the importer instead",
    "sample": _EVENTS,
    "pre": _EVENTS,
    "edge": _EVENTS,
    "change": _EVENTS,
    "initial": "give start values with fixed=true",
    "terminal": "read the last value from the importer instead",
    "spatialDistribution": "use delay() if the velocity is constant",
    "semiLinear": "write it as an if-expression",
    "cardinality": "use a parameter",
    "inStream": "use flow variables only",
    "actualStream": "use flow variables only",
    "impure": "call no impure function",
}


def audit_sources(tree: SourceTree, model: str) -> list[ModelicaClass]:
    """Refuse unsupported constructs in the classes that a model uses.

    The compiler drops some of them without a word (an assert within an if-equation) and decides others for
    good (a component that exists under a condition), so the source text is what is looked at.

    Args:
        tree: the source files.
        model: qualified name of the model.
    Returns: the classes that the model uses.
    Raises: BuildError that lists every finding as file:line.
    """
    used = used_classes(tree.classes, model)
    problems: list[str] = []
    for item in used:
        # Functions are refused where they are called: a package may well hold functions that nobody calls.
        if item.kind != "function":
            problems.extend(_class_problems(tree, item))
    if problems:
        raise BuildError("\n".join(problems))
    return used


def audit_flattened(
    tree: SourceTree,
    used: Iterable[ModelicaClass],
    delays: set[tuple[str, int]],
    asserts: Sequence[tuple[str, int, int]],
) -> None:
    """Compare delay() and assert() in the source with what the flattened model holds.

    Args:
        tree: the source files.
        used: the classes that the model uses.
        delays: path and byte offset of every delay in the flattened model.
        asserts: path, first and last byte offset of every assertion in the flattened model.
    Raises: BuildError if one is missing.
    """
    problems = []
    for item in used:
        if item.kind == "function":
            continue
        calls = {token.start for token in tree.delay_calls(item.file)}
        text = tree.texts[item.file]

        def offset(token: Token, text: str = text) -> int:
            return len(text[: token.start].encode())

        for token in item.tokens:
            if token.start in calls and (item.file, offset(token)) not in delays:
                problems.append(
                    f"{tree.at(item.file, token)}: delay() is lost in flattening; put it into an equation of "
                    "its own"
                )
        for token, loop, _ in _asserts(item):
            # An assert in a for-loop is placed at the loop's index.
            at = offset(loop or token)
            if not any(file == item.file and start <= at < end for file, start, end in asserts):
                problems.append(
                    f"{tree.at(item.file, token)}: assert() is lost in flattening; put it into the equation "
                    "section"
                )
    if problems:
        raise BuildError("\n".join(problems))


def experiment(item: ModelicaClass) -> dict[str, float]:
    """Return the numbers of a class's `experiment` annotation, such as StopTime [s]; {} without one."""
    for annotation in item.annotations:
        for index, token in enumerate(annotation):
            if token.text != "experiment" or index + 1 == len(annotation):
                continue
            values: dict[str, float] = {}
            for key, equals, value in zip(
                annotation[index:], annotation[index + 1 :], annotation[index + 2 :], strict=False
            ):
                if key.text == ")":
                    break
                if key.kind == "name" and equals.text == "=" and value.kind == "number":
                    values[key.text] = float(value.text)
            return values
    return {}


def _class_problems(tree: SourceTree, item: ModelicaClass) -> list[str]:
    problems = []
    tokens = item.tokens
    for index, token in enumerate(tokens):
        following = tokens[index + 1].text if index + 1 < len(tokens) else ""
        before = tokens[index - 1].text if index else ""
        place = tree.at(item.file, token)
        if token.kind == "keyword" and token.text in _KEYWORDS and before != "end":
            problems.append(f"{place}: `{token.text}` is not supported; {_KEYWORDS[token.text]}")
        elif token.text == "initial" and following in ("equation", "algorithm"):
            problems.append(
                f"{place}: `initial {following}` is not supported; give start values with fixed=true instead"
            )
        elif token.text in _CALLS and following == "(" and before != "." and token.kind != "string":
            problems.append(f"{place}: {token.text}() is not supported; {_CALLS[token.text]}")
    problems.extend(_conditional_components(tree, item))
    problems.extend(_nested_asserts(tree, item))
    return problems


def _conditional_components(tree: SourceTree, item: ModelicaClass) -> list[str]:
    problems = []
    first: Token | None = None
    open_ifs = 0
    for index, token in enumerate(item.tokens):
        if token.text == "if" and (index == 0 or item.tokens[index - 1].text != "end"):
            first = first or token
            open_ifs += 1
        elif token.text == "elseif":
            open_ifs += 1
        elif token.text == "then":
            open_ifs -= 1
        elif token.text == ";":
            if first is not None and open_ifs > 0:
                problems.append(
                    f"{tree.at(item.file, first)}: a conditional component is not supported; "
                    "make two models of it, one with the component and one without"
                )
            first, open_ifs = None, 0
    return problems


def _nested_asserts(tree: SourceTree, item: ModelicaClass) -> list[str]:
    """Asserts within if-equations; flattening drops them."""
    return [
        f"{tree.at(item.file, token)}: assert() within an if-equation is not supported; put it "
        "into the equation section and the condition into its first argument"
        for token, _, conditional in _asserts(item)
        if conditional
    ]


def _asserts(item: ModelicaClass) -> list[tuple[Token, Token | None, bool]]:
    """Every assert of the equation sections, the index of the innermost for-loop around it, if any, and
    whether an if-equation is around it.
    """
    found: list[tuple[Token, Token | None, bool]] = []
    tokens = item.tokens
    around: list[Token | None] = []  # index of a for-loop, None for an if-equation
    position = next((i + 1 for i, token in enumerate(tokens) if token.text == "equation"), len(tokens))
    while position < len(tokens):
        token = tokens[position]
        if token.text in ("if", "elseif"):
            if token.text == "if":
                around.append(None)
            # The condition may hold if-expressions, each with a `then` of its own.
            waiting = 1
            position += 1
            while position < len(tokens) and waiting:
                waiting += {"if": 1, "elseif": 1, "then": -1}.get(tokens[position].text, 0)
                position += 1
            continue
        if token.text == "for" and position + 1 < len(tokens):
            around.append(tokens[position + 1])
            while position < len(tokens) and tokens[position].text != "loop":
                position += 1
        elif token.text not in ("else", "equation"):
            if token.text == "end" and around:
                around.pop()
            elif token.text == "assert":
                loops = [index for index in around if index is not None]
                found.append((token, loops[-1] if loops else None, len(loops) < len(around)))
            while position < len(tokens) and tokens[position].text != ";":
                position += 1
        position += 1
    return found
