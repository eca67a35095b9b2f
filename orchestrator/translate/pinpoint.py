"""Where a fault is that the compiler reports without a place: the equation without which it is gone."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from .lexer import Token
from .sources import Location, SourceTree

# Each try compiles the model once.
_MOST_TRIES = 150
_OPENING = ("for", "if", "when", "while")


def offending_place(
    tree: SourceTree, model: str, message_of: Callable[[SourceTree], str], message: str
) -> Location | None:
    """The place of the equation or binding without which the compiler does not say what it does.

    Args:
        tree: the source files, whose compilation gives a message.
        model: qualified name of the model.
        message_of: compiles a tree; returns the message, "" if there is none.
        message: what the compiler says, in its own words.
    """
    item = tree.classes[model]
    text = tree.texts[item.file]
    if message not in message_of(tree):
        return None
    for count, (first, last) in enumerate(statements(item.tokens)):
        if count >= _MOST_TRIES:
            break
        end = last.start + len(last.text)
        blank = "".join(one if one == "\n" else " " for one in text[first.start : end])
        less = replace(tree, texts={**tree.texts, item.file: text[: first.start] + blank + text[end:]})
        if message not in message_of(less):
            return tree.at(item.file, first)
    return None


def statements(tokens: list[Token]) -> Iterator[tuple[Token, Token]]:
    """First and last token of each equation, and of each value that a declaration gives."""
    begin, depth, brackets, section = 0, 0, 0, False
    value = -1
    for index, token in enumerate(tokens):
        before = tokens[index - 1].text if index else ""
        if token.text in ("equation", "algorithm"):
            section, begin = True, index + 1
            continue
        brackets += {"(": 1, "[": 1, "{": 1, ")": -1, "]": -1, "}": -1}.get(token.text, 0)
        # An expression's if has no end.
        if token.text in _OPENING and section and index == begin:
            depth += 1
        elif token.text in _OPENING and section and depth and before in (";", "loop", "then", "else"):
            depth += 1
        elif token.text == "end" and section:
            depth -= 1
        if not section and token.text == "=" and brackets == 0:
            value = index
        if token.text == ";" and depth <= 0 and brackets == 0:
            if section and tokens[begin].text != "end":
                yield tokens[begin], token
            elif not section and value > 0:
                yield tokens[value], tokens[index - 1]
            begin, depth, value = index + 1, 0, -1
