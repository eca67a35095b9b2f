"""Find the classes of Modelica files, their own tokens and which of them a model uses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from orchestrator.base.errors import BuildError

from .lexer import Token, closing, tokenise

CLASS_KEYWORDS = frozenset("class model block connector type package function record operator".split())


@dataclass(eq=False)
class ModelicaClass:
    """One class definition.

    Attributes:
        name: fully qualified, with dots.
        kind: its keyword, such as "model".
        file: name of the file it stands in.
        line: of its keyword.
        tokens: its own tokens, without those of the classes defined within it and without annotations.
        annotations: the tokens of its annotations, one tuple each.
    """

    name: str
    kind: str
    file: str
    line: int
    tokens: list[Token] = field(default_factory=list)
    annotations: list[tuple[Token, ...]] = field(default_factory=list)


def within_clause(tokens: Iterable[Token]) -> str:
    """Return the package named by a file's `within` clause; "" without one."""
    tokens = list(tokens)
    if not tokens or tokens[0].text != "within":
        return ""
    end = next((i for i, token in enumerate(tokens) if token.text == ";"), len(tokens))
    return "".join(token.text for token in tokens[1:end])


def find_classes(texts: Mapping[str, str], label: str = "") -> dict[str, ModelicaClass]:
    """Return every class of the files by its qualified name.

    Args:
        texts: path of a file -> its content.
        label: what is put before a path in messages.
    Raises: BuildError if a file is no Modelica, has a keyword for a name, or two classes have one name.
    """
    found: dict[str, ModelicaClass] = {}
    for file, text in texts.items():
        tokens = tokenise(text, label + file)
        _refuse_keywords_as_names(tokens, label + file)
        for item in _classes_of(file, tokens, label):
            if item.name in found:
                other = found[item.name]
                raise BuildError(
                    f"{label}{file}:{item.line}: class {item.name} is already defined at "
                    f"{label}{other.file}:{other.line}"
                )
            found[item.name] = item
    return found


def _refuse_keywords_as_names(tokens: Sequence[Token], file: str) -> None:
    """A class's kind is followed by the class's name; a variable that is called like it, by a sign."""
    for token, after in pairwise(tokens):
        if token.kind == "keyword" and token.text in CLASS_KEYWORDS and after.kind == "sign":
            raise BuildError(
                f"{file}:{token.line}: `{token.text}` is a keyword of Modelica and names nothing; choose "
                f"another name, as {token.text}_1"
            )


def used_classes(classes: Mapping[str, ModelicaClass], model: str) -> list[ModelicaClass]:
    """Return the classes that a model may use: itself, every class it names, those that they name, ...

    A name that could mean several classes stands for all of them: a class too many is looked at rather
    than one too few.

    Args:
        classes: all classes by qualified name.
        model: qualified name of the model.
    """
    endings: dict[str, list[str]] = {}
    for name in classes:
        endings.setdefault(name.rsplit(".", 1)[-1], []).append(name)
    seen = {model}
    queue = [model]
    while queue:
        here = queue.pop()
        for path in _mentions(classes[here].tokens):
            for name in _meanings(path, here, classes, endings):
                if name not in seen:
                    seen.add(name)
                    queue.append(name)
    return [item for name, item in classes.items() if name in seen]


def _meanings(
    path: list[str], scope: str, classes: Mapping[str, ModelicaClass], endings: Mapping[str, list[str]]
) -> Iterator[str]:
    for length in range(len(path), 0, -1):
        tail = ".".join(path[:length])
        outer = scope
        while True:
            name = f"{outer}.{tail}" if outer else tail
            if name in classes:
                yield name
                return
            if not outer:
                break
            outer = outer.rpartition(".")[0]
        # Not in an enclosing class: inherited or imported.
        matches = [name for name in endings.get(path[length - 1], ()) if f".{name}".endswith(f".{tail}")]
        if matches:
            yield from matches
            return


def _mentions(tokens: list[Token]) -> Iterator[list[str]]:
    path: list[str] = []
    dot = False
    for token in tokens:
        if token.kind == "name":
            if path and not dot:
                yield path
                path = []
            path.append(token.text)
            dot = False
        elif token.text == ".":
            dot = True
        else:
            if path:
                yield path
            path, dot = [], False
    if path:
        yield path


def _classes_of(file: str, tokens: tuple[Token, ...], label: str) -> Iterator[ModelicaClass]:
    prefix = within_clause(tokens)
    stack: list[ModelicaClass] = []
    # Of parentheses: what they hold modifies, and defines no class, as in `a(redeclare package P = Q)`.
    position = depth = 0
    while position < len(tokens):
        token = tokens[position]
        depth = 0 if token.text == ";" else max(depth + {"(": 1, ")": -1}.get(token.text, 0), 0)
        following = tokens[position + 1] if position + 1 < len(tokens) else None
        if token.kind == "keyword" and token.text == "annotation" and stack:
            end = closing(tokens, position + 1) + 1
            stack[-1].annotations.append(tokens[position + 1 : end])
            position = end
            continue
        if token.text == "end" and following is not None and following.kind == "name" and stack:
            if stack[-1].name.rpartition(".")[2] == following.text:
                yield stack.pop()
                position += 2
                continue
        opens = token.kind == "keyword" and token.text in CLASS_KEYWORDS and not depth
        if opens and following is not None:
            position += 1
            if following.text == "extends":
                position += 1
            named = tokens[position] if position < len(tokens) else None
            after = tokens[position + 1] if position + 1 < len(tokens) else None
            if named is not None and named.kind == "name":
                outer = stack[-1].name if stack else prefix
                item = ModelicaClass(
                    f"{outer}.{named.text}" if outer else named.text, token.text, file, token.line
                )
                if after is not None and after.text == "=":
                    end = position
                    while end < len(tokens) and tokens[end].text != ";":
                        end = closing(tokens, end) + 1 if tokens[end].text == "(" else end + 1
                    item.tokens.extend(tokens[position + 2 : end])
                    yield item
                    position = end
                else:
                    stack.append(item)
                    position += 1
                continue
            continue
        if stack:
            stack[-1].tokens.append(token)
        position += 1
    if stack:
        raise BuildError(
            f"{label}{file}:{stack[-1].line}: {stack[-1].kind} {stack[-1].name} is not closed by its `end`"
        )
