"""The compiler's messages in terms of the source: the place, what is wrong, and what to write instead."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from orchestrator.base.errors import BuildError, nearest

from .classes import ModelicaClass, used_classes
from .pinpoint import offending_place
from .sources import Location, SourceTree

UNBALANCED = "unbalanced model"
"""Of the compiler's message about a model with too many or too few equations."""


class CompilerRefusal(BuildError):
    """A model that the compiler refuses."""


_STAGE = re.compile(r"^\s*(?:\w+ failed: \S+ failed in \w+: |\S+ could not be compiled: |- \S+ \[\w+\]: )")
# Causes of one message that are shown; the compiler lists each file of a library whose folder it cannot read.
_CAUSES = 3
_SPOT = re.compile(r"\[([^\]\[]*?):(\d+):(\d+)\]")
_BUILT_IN = (
    "der abs sign sqrt div mod rem ceil floor integer sin cos tan asin acos atan atan2 sinh cosh tanh exp "
    "log log10 sum product min max size fill zeros ones linspace transpose cross pre edge change sample "
    "initial noEvent smooth delay homotopy".split()
)
_NO_LIBRARY = "The Modelica Standard Library is not found: name its folder by --library or MODELICAPATH."


@dataclass(frozen=True)
class _Sources:
    """Where a name or construct stands in the classes that a model uses."""

    tree: SourceTree
    model: str

    def classes(self) -> list[ModelicaClass]:
        own = self.tree.classes[self.model]
        return [own, *(one for one in used_classes(self.tree.classes, self.model) if one is not own)]

    def start(self) -> Location:
        item = self.tree.classes[self.model]
        return Location(self.tree.shown(item.file), item.line)

    def all(self, *texts: str) -> Iterator[tuple[ModelicaClass, int]]:
        for item in self.classes():
            tokens = [token.text for token in item.tokens]
            for index in range(len(tokens) - len(texts) + 1):
                if tuple(tokens[index : index + len(texts)]) == texts:
                    yield item, index

    def find(self, *texts: str, last: bool = False) -> Location:
        """The first or last place of these tokens; that of the model if there is none."""
        places = [self.tree.at(item.file, item.tokens[index]) for item, index in self.all(*texts)]
        return places[-1 if last else 0] if places else self.start()

    def name(self, name: str) -> Location:
        """The place of a dotted name, or of its last part."""
        parts = re.findall(r"\w+|\.", name)
        found = self.find(*parts)
        return found if found != self.start() or len(parts) == 1 else self.find(parts[-1])

    def names(self) -> set[str]:
        return {token.text for item in self.classes() for token in item.tokens if token.kind == "name"}

    def near(self, name: str, others: set[str]) -> str:
        hint = nearest(name, sorted(others - {name}))
        return f" {hint}" if hint else ""

    def after(self, word: str, name: str) -> Location:
        """The place of a dotted name behind a word, or that of the word."""
        parts = tuple(re.findall(r"\w+|\.", name))
        for item, index in self.all(*parts):
            if any(one.text == word for one in item.tokens[max(0, index - 12) : index]):
                return self.tree.at(item.file, item.tokens[index])
        return self.find(word)

    def declared_as(self, name: str, kind: str) -> bool:
        """Whether a component is declared of a type whose name ends so."""
        return any(True for _ in self.all(kind.rpartition(".")[2], name))

    def function_part(self, function: str, texts: tuple[str, ...]) -> Location:
        for item in self.tree.classes.values():
            if item.kind == "function" and item.name.rpartition(".")[2] == function:
                for token in item.tokens:
                    if token.text in texts:
                        return self.tree.at(item.file, token)
        return self.name(function)

    def derivative(self) -> Location:
        """The first der() of anything but a variable."""
        for item, index in self.all("der", "("):
            rest = [token for token in item.tokens[index + 2 : index + 60]]
            depth = 0
            for token in rest:
                depth += {"[": 1, "]": -1}.get(token.text, 0)
                if depth == 0 and token.text == ")":
                    break
                if depth == 0 and not (token.kind == "name" or token.text in (".", "]")):
                    return self.tree.at(item.file, item.tokens[index])
        return self.find("der")


Rule = tuple[str, Callable[[_Sources, "re.Match[str]"], tuple[Location, str]]]


def _unknown(s: _Sources, found: re.Match[str]) -> tuple[Location, str]:
    name = found[1]
    what = f"`{name}` is declared nowhere in reach; declare it, or correct its name."
    return s.name(name), what + s.near(name.rpartition(".")[2], s.names())


def _unknown_class(s: _Sources, found: re.Match[str]) -> tuple[Location, str]:
    name = found[1]
    if name.partition(".")[0] == "Modelica":
        return s.name(name), f"no class `{name}`. {_NO_LIBRARY}"
    known = {one.rpartition(".")[2] for one in s.tree.classes}
    what = f"no class `{name}`; define it, import it, or name the folder of its library by --library."
    return s.name(name), what + s.near(name.rpartition(".")[2], known)


def _unknown_function(s: _Sources, found: re.Match[str]) -> tuple[Location, str]:
    name = found[1]
    functions = {one.rpartition(".")[2] for one, item in s.tree.classes.items() if item.kind == "function"}
    what = f"no function `{name}`; define it, or correct its name."
    return s.name(name), what + s.near(name.rpartition(".")[2], functions | set(_BUILT_IN))


def _comparison(s: _Sources, _: re.Match[str]) -> tuple[Location, str]:
    places = [s.find(sign) for sign in ("==", "<>")]
    place = next((one for one in places if one != s.start()), s.start())
    return place, "== and <> of Reals are not allowed in Modelica; use < or >, or compare Integers"


def _branches(s: _Sources, found: re.Match[str]) -> tuple[Location, str]:
    condition = re.findall(r"\w+|[^\w\s]+", found[1].strip("()"))
    what = (
        "the branches of this if-equation have unlike numbers of equations; give each as many, with an else"
    )
    return s.find("if", *condition), what


_INSTEAD = {
    "spatialDistribution": "; use delay() if the velocity is constant, else divide the length into volumes",
    "getInstanceName": "; give the name as a String parameter",
    "scalar": "; name the element by its subscripts, as a[1, 1]",
    "matrix": "; write brackets around the array, as [a]",
    "symmetric": "; write out the elements",
    "ndims": "; write the number",
}
_RULES: tuple[Rule, ...] = (
    (r"unresolved component reference: '([^']+)'", _unknown),
    (r"unresolved function call: '([^']+)'", _unknown_function),
    (r"unresolved type reference: '([^']+)'", _unknown_class),
    (
        r"cyclic dependency in parameter binding for '([^']+)'",
        lambda s, m: (s.find(m[1], "="), f"the value of `{m[1]}` depends on itself; give it a number"),
    ),
    (r"equality comparison on Real values is not allowed", _comparison),
    (
        r"reinit\(\) can only be applied to state variables: (\S+) is not a state",
        lambda s, m: (
            s.find("reinit", "(", m[1]),
            f"reinit() of {m[1]}, which is no state; reinit a variable whose der() stands in an equation, or "
            f"set {m[1]} in the when-clause",
        ),
    ),
    (
        r"`function statement`: `([^`]+)` contains",
        lambda s, m: (
            s.function_part(m[1].rpartition(".")[2], ("while", "break", "return", "assert")),
            f"a statement of the function {m[1]} is not supported; functions may hold assignments, if and "
            "for; write while and break as for with if",
        ),
    ),
    (r"if-equation branches have mismatched equation counts.*?conditions \[(.*?)\]", _branches),
    (
        r"`(\w+)` has more than one semantic definition owner",
        lambda s, m: (
            s.find(m[1], "=", last=True),
            f"`{m[1]}` is set in several when-clauses; set it in one, with elsewhen",
        ),
    ),
    (
        r"`derivative expression`",
        lambda s, m: (
            s.derivative(),
            "der() of an expression is not supported; give the expression a variable of its own, and take "
            "der() of that",
        ),
    ),
    (
        r"sample interval is not parameter-evaluable(?:: unknown variable: (\w+))?",
        lambda s, m: (
            s.find("sample", "("),
            "the period of sample() changes while the model runs, which is not supported; give a number or a "
            "parameter with a value",
        ),
    ),
    (
        r"delayTime is not",
        lambda s, m: (
            s.find("delay", "("),
            "the time of delay() beside events has to be a number or a parameter with a value",
        ),
    ),
    (
        r"expandable connector connection between `([^`]+)` and `([^`]+)`",
        lambda s, m: (
            s.name(m[1]),
            f"of `{m[1]}` and `{m[2]}` one is a member of an expandable connector that only this connection "
            "declares; that may be a scalar signal or a bus: declare arrays in the connector, and connect "
            "physical connectors without it",
        ),
    ),
    (
        r"redeclaration error for `([^`]+)`: selected redeclare class has no such member",
        lambda s, m: (
            s.find(".", m[1]),
            f"`{m[1]}` is declared by no class that its connector or component has; if the connector is "
            "expandable, declare its members in it, or connect scalar signals to them",
        ),
    ),
    (
        r"cannot redeclare `([^`]+)`: element is declared final",
        lambda s, m: (
            s.find(m[1]),
            f"`{m[1]}` is declared final and cannot be modified; drop one of the two",
        ),
    ),
    (
        r"Duplicate declaration of '(\w+)' at line (\d+)",
        lambda s, m: (s.find(m[1], last=True), f"`{m[1]}` is declared a second time; give it another name"),
    ),
    (
        r"unresolved Flat reference `([\w.]+\.\w+)`",
        lambda s, m: (
            s.name(m[1]),
            f"`{m[1]}` of an array of components that has several dimensions, or no elements, is not "
            "supported as a whole; name the elements, as {{a[i, j].x for j in 1:3} for i in 1:2}",
        ),
    ),
    (
        r"`record-array member slice`",
        lambda s, m: (
            s.start(),
            "arrays of components within arrays of components are not supported as a whole; name the "
            "elements, as {{a[i].b[j].x for j in 1:3} for i in 1:2}",
        ),
    ),
    (
        r"unsupported runtime operator `(scalar|matrix|symmetric|ndims)`",
        lambda s, m: (s.find(m[1], "("), f"{m[1]}() is not supported{_INSTEAD[m[1]]}"),
    ),
    (
        r"expression type mismatch: expected Real, found Integer",
        lambda s, m: (
            s.start(),
            "numbers without a point stand here where the compiler takes Reals only; write them as 1.0",
        ),
    ),
    (
        r"`when assignment`: `([^`]+)` is not a discrete coordinate",
        lambda s, m: (
            s.find("when"),
            f"a when-equation that sets elements of an array ({m[1]}) is not supported where it holds a for "
            "or its equations need each other; write it as an algorithm section",
        ),
    ),
    (
        r"expected a numeric expression, found Enumeration",
        lambda s, m: (
            s.start(),
            "an enumeration stands where a number is needed; Integer(e) is its number, where e is a variable "
            "that this class declares",
        ),
    ),
    (
        r"missing source scope for imports",
        lambda s, m: (
            s.find("(", ","),
            "a result that is left out before others, as in (, y) = f(x), is not supported; name a variable",
        ),
    ),
    (
        r"unresolved Flat reference `(\w+)`",
        lambda s, m: (
            s.find(m[1]),
            f"{m[1]}() is not supported{_INSTEAD.get(m[1], '')}"
            if s.find(m[1], "(") != s.start()
            else f"this use of `{m[1]}` as a whole is not supported; name its elements",
        ),
    ),
    (
        r"expression shape mismatch",
        lambda s, m: (
            s.start(),
            "the two sides are of unlike types, as a Real for an Integer or a Boolean, or a modifier has not "
            "the sizes of its element; convert one, as by integer(x), x > 0 or if b then 1 else 0. "
            "Sizes of arrays of components have to follow from numbers and Integer parameters, not size()",
        ),
    ),
    (
        r"base class not found: `([^`]+)`|unresolved extends base class: '([^']+)'",
        lambda s, m: (
            s.find("extends", *re.findall(r"\w+|\.", m[1] or m[2])),
            f"no class `{m[1] or m[2]}` to extend; define it, or name the folder of its library by --library",
        ),
    ),
    (
        r"unresolved import: '([^']+)'",
        lambda s, m: (
            s.find("import"),
            f"nothing to import at `{m[1]}`. {_NO_LIBRARY}"
            if m[1].startswith("Modelica.")
            else f"nothing to import at `{m[1]}`; correct the name, or name the folder of its library by "
            "--library",
        ),
    ),
    (
        r"invalid call of function `([^`]+)`: (\d+) positional argument\(s\) for (\d+) input",
        lambda s, m: (
            s.find(m[1], "("),
            f"the function {m[1]}() takes {m[3]} inputs, here are {m[2]}; give as many, or some by name",
        ),
    ),
    (
        r"invalid call of function `([^`]+)`: named argument `([^`]+)` does not match",
        lambda s, m: (s.find(m[2], "="), f"the function {m[1]}() has no input `{m[2]}`; correct its name"),
    ),
    (
        r"connect argument '([^']+)' must be a connector",
        lambda s, m: (
            s.after("connect", m[1]),
            f"connect() takes connectors, `{m[1]}` is none; write an equation, or declare a connector",
        ),
    ),
    (
        r"reinit\(\) can only be used inside when-equations",
        lambda s, m: (s.find("reinit"), "reinit() stands in no when-clause; put it into one"),
    ),
    (
        r"when-equations cannot be nested",
        lambda s, m: (s.find("when"), "a when within a when is not allowed; join the conditions by `and`"),
    ),
    (
        r"`pre expression`: pre\(`([^`]+)`\)",
        lambda s, m: (
            s.find("pre", "(", *re.findall(r"\w+|\.", m[1])),
            f"pre({m[1]}) of a continuous variable has a meaning in when-clauses only; drop pre()",
        ),
    ),
    (
        r"sequential read",
        lambda s, m: (
            s.find("algorithm"),
            "an algorithm that reads what it has set before is not supported here; make a function or "
            "equations of it",
        ),
    ),
    (
        r"impure function `([^`]+)` is called from a pure function",
        lambda s, m: (
            next((place for one in ("Noise", "Random") if (place := s.find(one)) != s.start()), s.start()),
            f"random numbers and other impure functions ({m[1]}) are not supported; read the numbers from a "
            "table, as by CombiTimeTable, or make them an input",
        ),
    ),
    (
        r"der\(\.\.\.\) must name a coordinate",
        lambda s, m: (
            s.find("der"),
            "der() of an input or of a value that jumps is not supported; give the derivative as a further "
            "input",
        ),
    ),
)
# Messages with a place of their own.
_TYPED = (
    (
        r"type mismatch: expected `(\w+)`, found `(\w+)`",
        r"the types \1 and \2 do not fit together here; convert one, as by if b then 1 else 0, x > 0 or "
        r"integer(x)",
    ),
    (
        r"array dimension mismatch: expected `(\[.*?\])`, found `(\[.*?\])`",
        r"arrays of the sizes \1 and \2 do not fit together here; correct a declaration or a side",
    ),
    (
        r"operator `([^`]+)` expects Real or Integer operand\(s\), found `(\w+)`",
        r"`\1` takes numbers, this is a \2; convert it, as by if b then 1 else 0 or String(x)",
    ),
    (
        r"(\w+)\(\) expects (\d+) argument\(s\), found (\d+)",
        r"\1() takes \2 arguments, here are \3; correct the call",
    ),
    (
        r"when-equation condition must be Boolean, found `(\w+)`",
        r"the condition of a when is a Boolean, this is a \1; write a relation, as x > 0",
    ),
    (
        r"unknown modifier `(\w+)` for component `([^`]+)` of type `([^`]+)`",
        r"\3 has no `\1` that \2 could modify; correct the name",
    ),
    (
        r"subscript (-?\d+) for `([^`]+)` is out of bounds for dimension of size (\d+)",
        r"the subscript \1 of \2 is outside 1 to \3; correct it or the size",
    ),
)


def explained(
    tree: SourceTree, model: str, text: str, message_of: Callable[[SourceTree], str] | None = None
) -> str:
    """The compiler's message, one fault after the other, each with its place in the source files.

    Args:
        text: of the compiler, with the names of the source files.
        message_of: compiles a changed tree; finds the place of a fault that the compiler reports without one.
    """
    sources = _Sources(tree, model)
    lines = [_STAGE.sub("", line) for line in text.splitlines()]
    lines = list(dict.fromkeys(line.strip() for line in lines if line.strip()))
    missing = re.findall(r"unresolved type reference: '([^']+)'", text)
    faults: dict[str, None] = {}
    for line in lines:
        if line.startswith("Related failures"):
            continue
        member = re.match(r"unresolved component reference: '(\w+)\.", line)
        if member and any(sources.declared_as(member[1], kind) for kind in missing):
            continue  # follows from the missing type
        for fault in _of_line(sources, line):
            start = f"{sources.start()}: "
            if message_of is not None and fault.startswith(start) and UNBALANCED not in fault:
                if place := offending_place(tree, model, message_of, line):
                    fault = f"{place}: {fault.removeprefix(start)}"
            faults[fault] = None
    return "\n".join(faults)


def _of_line(sources: _Sources, line: str) -> list[str]:
    # Places that the compiler gives itself; its line may hold several messages.
    spots = list(_SPOT.finditer(line))
    if spots:
        begin, found = 0, []
        for spot in spots:
            what = line[begin : spot.start()].strip(" ;")
            begin = spot.end()
            for pattern, instead in _TYPED:
                what, count = re.subn(pattern + r"(?: \(MLS [^)]*\))?", instead, what)
                if count:
                    break
            what = _plain(what)
            found.append(f"{_restored(sources, spot)}: {what}")
        return found
    for pattern, meaning in _RULES:
        if match := re.search(pattern, line):
            place, what = meaning(sources, match)
            return [f"{place}: {what}"]
    if re.match(r".*\.mo:\d+", line):
        return [line]
    return [f"{sources.start()}: the Modelica compiler refuses {sources.model}: {_plain(line)}"]


def _plain(line: str) -> str:
    """A message without references to sections of the language specification, and with its first causes."""
    plain = re.sub(r" \(MLS §[^)]*\)|; MLS §.*", "", line)
    causes = plain.split("; ")
    more = len(causes) - _CAUSES
    return plain if more < 2 else f"{'; '.join(causes[:_CAUSES])}; and {more} more"


def _restored(sources: _Sources, spot: re.Match[str]) -> Location:
    """A place in the file that the compiler saw, in the user's."""
    tree, line, column = sources.tree, int(spot[2]), int(spot[3])
    path = next((one for one in tree.texts if tree.shown(one) == spot[1]), "")
    if not path:
        return Location(spot[1], line, column)
    seen = tree.marked(path).split("\n")
    offset = len("\n".join([*seen[: line - 1], seen[line - 1][: column - 1]]).encode())
    return tree.place(path, tree.restore_offset(path, offset))
