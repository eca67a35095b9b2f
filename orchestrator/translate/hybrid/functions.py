"""Functions that the compiler does not evaluate (while, break, return, dependent loops), as C.

Each is written once for each set of sizes of its inputs.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from orchestrator.base.errors import BuildError

from ..built_in import FUNCTIONS, STEPS
from . import expression as ex
from .expression import Expr
from .statements import RELATIONS, FunctionSource, Node, Parser, Variable

Source = Callable[[str], "FunctionSource | None"]

CONSTANTS = {
    "pi": np.pi, "e": np.e, "eps": 2.220446049250313e-16, "small": 1e-60, "inf": 1.7976931348623157e308,
    "D2R": np.pi / 180, "R2D": 180 / np.pi,
}  # fmt: skip


@dataclass
class _Function:
    """A function for inputs of certain sizes."""

    number: int
    name: str
    outputs: list[tuple[int, ...]] = field(default_factory=list)
    lines: list[str] = field(default_factory=list)
    inputs: int = 0
    includes: str = ""


_MADE: dict[Any, _Function] = {}
_numbers = itertools.count()
Value = np.ndarray  # of C expressions


class _Writer:
    """The body of one function in C."""

    def __init__(
        self, source: FunctionSource, known: Source, shapes: Sequence[tuple[int, ...]], made: _Function
    ):
        self._name = source.name
        self._known = known
        self._made = made
        self._variables, statements = Parser(source).function()
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._fixed: dict[str, float] = {}
        self._lines: list[str] = []
        self._loops: dict[str, str] = {}
        self._temporary = itertools.count()
        inputs = [one for one in self._variables if one.role == "input"]
        place = 0
        for one, shape in zip(inputs, shapes, strict=False):
            self._shapes[one.name] = shape
            size = int(np.prod(shape, dtype=int))
            self._lines.append(f"double v_{one.name}[{max(size, 1)}] = {{0}};")
            self._lines.append(
                f"for (int k = 0; k < {size}; k++) v_{one.name}[k] = in[{place} + k];" if size else ""
            )
            place += size
        made.inputs = place
        for one in [*inputs[len(shapes) :], *(v for v in self._variables if v.role != "input")]:
            self._declare(one)
        made.outputs = [self._shapes[one.name] for one in self._variables if one.role == "output"]
        self._write(statements)
        self._lines.append("done: (void)0;")
        place = 0
        for one in self._variables:
            if one.role == "output":
                size = int(np.prod(self._shapes[one.name], dtype=int))
                self._lines.append(
                    f"for (int k = 0; k < {size}; k++) out[{place} + k] = bad ? NAN : v_{one.name}[k];"
                )
                place += size
        made.lines = [one for one in self._lines if one]

    def _error(self, what: str) -> BuildError:
        return BuildError(
            f"the function {self._name}(): {what} is not supported in functions with while, return, or loops "
            "whose limits change"
        )

    def _declare(self, one: Variable) -> None:
        value = None
        if one.binding is not None:
            fixed = self._constant(one.binding)
            if fixed is not None and not one.dimensions:
                self._fixed[one.name] = fixed
            value = self._value(one.binding)
        shape = []
        for place, dimension in enumerate(one.dimensions):
            size = None if dimension is None else self._constant(dimension)
            if size is None:
                if value is None:
                    raise self._error(f"the size of {one.name}, which is not known beforehand,")
                size = value.shape[place]
            shape.append(int(size))
        self._shapes[one.name] = tuple(shape)
        size = int(np.prod(shape, dtype=int))
        # A variable without a value is none: NaN ends the run where it is used.
        self._lines.append(f"double v_{one.name}[{max(size, 1)}];")
        self._lines.append(f"for (int k = 0; k < {size}; k++) v_{one.name}[k] = NAN;")
        if value is not None:
            self._assign(one.name, [], np.broadcast_to(value, shape))

    def _constant(self, node: Node) -> float | None:
        match node[0]:
            case "number":
                return float(node[1])
            case "name" if not node[2]:
                return self._fixed.get(node[1], named_constant(node[1]))
            case "negative":
                value = self._constant(node[1])
                return None if value is None else -value
            case "binary":
                a, b = self._constant(node[2]), self._constant(node[3])
                if a is None or b is None:
                    return None
                word = node[1].lstrip(".")
                simple = {"+": a + b, "-": a - b, "*": a * b}
                if word in simple:
                    return simple[word]
                if word == "/" and b:
                    return a / b
                return a**b if word == "^" else None
            case "call" if node[1] == "size" and len(node[2]) == 2:
                shape = self._value(node[2][0]).shape
                axis = self._constant(node[2][1])
                return None if axis is None else float(shape[int(axis) - 1])
            case "call" if node[1] in ("integer", "div", "max", "min") and len(node[2]) < 3:
                values = [self._constant(one) for one in node[2]]
                if any(one is None for one in values):
                    return None
                known = [one for one in values if one is not None]
                if node[1] == "integer":
                    return float(np.floor(known[0]))
                if len(known) == 2:
                    return {"div": lambda a, b: float(np.trunc(a / b)), "max": max, "min": min}[node[1]](
                        *known
                    )
        return None

    # Statements

    def _write(self, statements: Iterable[Node]) -> None:
        for one in statements:
            match one[0]:
                case "assign":
                    self._assigned(one[1], one[2])
                case "if":
                    self._branches(one[1], one[2])
                case "for":
                    self._loop(one[1], one[2])
                case "while":
                    self._lines.append("for (long turn = 0;; turn++) {")
                    self._lines.append(f"if (!({self._scalar(one[1])})) break;")
                    self._lines.append("if (turn > 10000000) { bad = 1; break; }")
                    self._write(one[2])
                    self._lines.append("}")
                case "break":
                    self._lines.append("break;")
                case "return":
                    self._lines.append("goto done;")
                case "do":
                    self._do(one[1])

    def _do(self, node: Node) -> None:
        if node[0] == "call" and node[1] == "assert":
            self._lines.append(f"if (!({self._scalar(node[2][0])})) {{ bad = 1; goto done; }}")
        elif node[0] == "call" and node[1].rpartition(".")[2] == "error":
            self._lines.append("{ bad = 1; goto done; }")
        else:
            raise self._error(f"the statement {node[1]}")

    def _branches(self, cases: Sequence[tuple[Node, list[Node]]], otherwise: list[Node]) -> None:
        for condition, body in cases:
            self._lines.append(f"if ({self._scalar(condition)}) {{")
            self._write(body)
            self._lines.append("} else {")
        self._write(otherwise)
        self._lines.append("}" * len(cases))

    def _loop(self, iterators: Sequence[tuple[str, Node]], body: list[Node]) -> None:
        (name, over), rest = iterators[0], iterators[1:]
        before = self._loops.get(name)
        number = next(self._temporary)
        if over[0] == "range":
            first, step, last = (self._scalar(one) for one in over[1:])
            self._lines.append(f"double a{number} = {first}, s{number} = {step}, b{number} = {last};")
            self._lines.append(
                f"long n{number} = s{number} == 0 ? -1 "
                f": (long)floor((b{number} - a{number}) / s{number} + 1e-10);"
            )
            self._lines.append(f"for (long k{number} = 0; k{number} <= n{number}; k{number}++) {{")
            self._lines.append(f"const double i{number} = a{number} + (double)k{number} * s{number};")
        else:
            values = list(self._value(over))
            self._lines.append(f"const double e{number}[] = {{{', '.join(map(str, values)) or '0'}}};")
            self._lines.append(f"for (int k{number} = 0; k{number} < {len(values)}; k{number}++) {{")
            self._lines.append(f"const double i{number} = e{number}[k{number}];")
        self._loops[name] = f"i{number}"
        if rest:
            self._loop(rest, body)
        else:
            self._write(body)
        self._lines.append("}")
        if before is None:
            del self._loops[name]
        else:
            self._loops[name] = before

    def _assigned(self, targets: Sequence[Node | None], value: Node) -> None:
        found = self._calls(value) if len(targets) > 1 else [self._value(value)]
        for target, one in zip(targets, found, strict=False):
            if target is not None:
                self._assign(target[1], target[2], one)

    def _assign(self, name: str, subscripts: Sequence[Node | None], value: Value) -> None:
        if name not in self._shapes:
            raise self._error(f"the assignment to {name}")
        self._fixed.pop(name, None)
        places = self._places(name, subscripts)
        values = np.broadcast_to(value, places.shape).ravel()
        if places.size == 1:
            self._lines.append(f"{places.ravel()[0]} = {values[0]};")
            return
        number = next(self._temporary)
        self._lines.append(f"{{ const double w{number}[] = {{{', '.join(map(str, values)) or '0'}}};")
        self._lines += [f"{place} = w{number}[{k}];" for k, place in enumerate(places.ravel())]
        self._lines.append("}")

    def _places(self, name: str, subscripts: Sequence[Node | None]) -> Value:
        shape = self._shapes[name]
        if not subscripts and not shape:
            return np.array(f"v_{name}[0]", dtype=object)
        axes: list[list[str] | str] = []
        for axis, size in enumerate(shape):
            node = subscripts[axis] if axis < len(subscripts) else None
            if node is None:
                axes.append([str(k) for k in range(size)])
                continue
            value = self._value(node, size)
            texts = [f"at_({one}, {size}, &bad)" for one in value.ravel()]
            axes.append(texts[0] if not value.shape else texts)
        strides = [int(np.prod(shape[axis + 1 :], dtype=int)) for axis in range(len(shape))]
        wide = [one if isinstance(one, list) else [one] for one in axes]
        places = np.empty([len(one) for one in wide], dtype=object)
        for index in np.ndindex(*places.shape):
            terms = [f"{wide[axis][k]} * {strides[axis]}" for axis, k in enumerate(index)]
            places[index] = f"v_{name}[{' + '.join(terms)}]"
        kept = tuple(len(one) for one in axes if isinstance(one, list))
        return places.reshape(kept)

    # Expressions

    def _scalar(self, node: Node) -> str:
        value = self._value(node)
        if value.size != 1:
            raise self._error(f"an array of {value.size} elements in place of one number")
        return str(value.item())

    def _value(self, node: Node, end: int | None = None) -> Value:
        match node[0]:
            case "number":
                return _as_value(repr(node[1]) if node[1] >= 0 else f"({node[1]!r})")
            case "end":
                return _as_value(str(end))
            case "text":
                raise self._error("a text in an expression")
            case "name":
                return self._named(node[1], node[2])
            case "negative":
                return _map(lambda a: f"(-{a})", self._value(node[1], end))
            case "not":
                return _map(lambda a: f"(!{a})", self._value(node[1], end))
            case "binary":
                return self._operation(node[1], self._value(node[2], end), self._value(node[3], end))
            case "choice":
                return self._choice(node, end)
            case "array":
                return np.array([self._value(one, end) for one in node[1]], dtype=object)
            case "matrix":
                rows = [
                    np.concatenate([np.atleast_2d(self._value(one)) for one in row], 1) for row in node[1]
                ]
                return np.concatenate(rows, 0)
            case "range":
                first, step, last = (self._constant(one) for one in node[1:])
                if first is None or step is None or last is None:
                    raise self._error("a range that is not known beforehand")
                count = max(0, int(np.floor((last - first) / step + 1e-9)) + 1)
                return np.array([repr(first + step * k) for k in range(count)], dtype=object)
            case "comprehension":
                (name, over), *rest = node[2]
                found = []
                for one in self._value(over):
                    self._loops[name] = str(one)
                    found.append(self._value(("comprehension", node[1], rest) if rest else node[1]))
                    del self._loops[name]
                return np.array(found, dtype=object)
            case "call":
                return self._calls(node, end)[0]
        raise self._error(f"an expression of the kind {node[0]}")

    def _choice(self, node: Node, end: int | None) -> Value:
        condition = self._scalar(node[1])
        kept, parts = self._lines, []
        for branch in node[2:]:
            self._lines = []
            parts.append((self._value(branch, end), self._lines))
        self._lines = kept
        (a, before_a), (b, before_b) = parts
        if not before_a and not before_b:
            return _map(lambda x, y: f"({condition} ? {x} : {y})", a, b)
        # What a branch computes beforehand only it may compute: it may call this function itself.
        number = next(self._temporary)
        shape = np.broadcast_shapes(a.shape, b.shape)
        self._lines.append(f"double c{number}[{max(1, int(np.prod(shape, dtype=int)))}];")
        for head, lines, value in ((f"if ({condition}) {{", before_a, a), ("} else {", before_b, b)):
            self._lines += [head, *lines]
            flat = np.broadcast_to(value, shape).ravel()
            self._lines += [f"c{number}[{k}] = {one};" for k, one in enumerate(flat)]
        self._lines.append("}")
        found = [f"c{number}[{k}]" for k in range(int(np.prod(shape, dtype=int)))]
        return np.array(found, dtype=object).reshape(shape)

    def _named(self, name: str, subscripts: Sequence[Node | None]) -> Value:
        if name in self._loops:
            return _as_value(self._loops[name])
        if name in self._shapes:
            return self._places(name, subscripts)
        if (value := named_constant(name)) is not None:
            return _as_value(repr(float(value)))
        raise self._error(f"the name {name}")

    def _operation(self, word: str, a: Value, b: Value) -> Value:
        plain = word.lstrip(".")
        if plain == "^":
            return _map(lambda x, y: f"pow({x}, {y})", a, b)
        if word == "*" and a.ndim and b.ndim:
            if a.ndim == b.ndim == 1:
                return _as_value(f"({' + '.join(f'{x} * {y}' for x, y in zip(a, b, strict=True)) or '0'})")
            if a.ndim == 2:
                columns = b if b.ndim == 2 else b[:, None]
                rows = [[self._operation("*", row, column).item() for column in columns.T] for row in a]
                found = np.array(rows, dtype=object)
                return found if b.ndim == 2 else found[:, 0]
            raise self._error("a product of a vector and a matrix")
        sign = {"and": "&&", "or": "||", **RELATIONS}.get(plain, plain)
        return _map(lambda x, y: f"({x} {sign} {y})", a, b)

    def _calls(self, node: Node, end: int | None = None) -> list[Value]:
        name, named = node[1], node[3]
        short = name.rpartition(".")[2]
        if name == "size":
            shape = self._value(node[2][0]).shape
            if len(node[2]) == 1:
                return [np.array([str(one) for one in shape], dtype=object)]
            axis = self._constant(node[2][1])
            if axis is None:
                raise self._error("size() of an axis that is not known beforehand")
            return [_as_value(str(shape[int(axis) - 1]))]
        source = None if name in _BUILT_IN else function_near(self._known, name, self._name)
        if source is None:
            arguments = [self._value(one, end) for one in node[2]]
            written = _BUILT_IN.get(short if short in FUNCTIONS else name)  # as Modelica.Math.sin
            if written is None:
                raise self._error(f"the function {name}()")
            return [written(arguments)]
        variables, _ = Parser(source).function()
        inputs = [one for one in variables if one.role == "input"]
        nodes = [*node[2]]
        for one in inputs[len(nodes) :]:
            if one.name in named:
                nodes.append(named[one.name])
            elif one.binding is not None:
                break
            else:
                raise self._error(f"a call of {name}() without {one.name}")
        arguments = [self._value(one, end) for one in nodes]
        made = _made(source, self._known, [one.shape for one in arguments])
        flat = [str(one) for argument in arguments for one in argument.ravel()]
        number = next(self._temporary)
        size = sum(int(np.prod(one, dtype=int)) for one in made.outputs)
        self._lines.append(f"const double g{number}[] = {{{', '.join(flat) or '0'}}};")
        self._lines.append(f"double r{number}[{max(size, 1)}]; function_{made.number}(g{number}, r{number});")
        found, place = [], 0
        for shape in made.outputs:
            count = int(np.prod(shape, dtype=int))
            texts = [f"r{number}[{place + k}]" for k in range(count)]
            found.append(np.array(texts, dtype=object).reshape(shape))
            place += count
        return found


def function_near(known: Source, name: str, scope: str) -> FunctionSource | None:
    """A function as a class names it, whose qualified name is `scope`."""
    while True:
        if found := known(f"{scope}.{name}" if scope else name):
            return found
        if not scope:
            return None
        scope = scope.rpartition(".")[0]


def _as_value(text: str) -> Value:
    found = np.empty((), dtype=object)
    found[()] = text
    return found


def _map(make: Callable[..., str], *values: Value) -> Value:
    spread = np.broadcast_arrays(*values)
    found = np.empty(spread[0].shape, dtype=object)
    for index in np.ndindex(*found.shape):
        found[index] = make(*(one[index] for one in spread))
    return found


def named_constant(name: str) -> float | None:
    """The value of a constant of the Modelica Standard Library by its path."""
    head, _, last = name.rpartition(".")
    if head.rpartition(".")[2] in ("Constants", "Machine"):
        return CONSTANTS.get(last)
    return None


def _folded(name: str) -> Callable[[Sequence[Value]], Value]:
    def made(values: Sequence[Value]) -> Value:
        if len(values) > 1:
            return _map(lambda a, b: f"{name}({a}, {b})", *values)
        flat = [str(one) for one in values[0].ravel()]
        text = flat[0]
        for one in flat[1:]:
            text = f"{name}({text}, {one})"
        return _as_value(text)

    return made


def _sized(
    fill: Callable[[Sequence[Value]], tuple[Value, Sequence[Value]]],
) -> Callable[[Sequence[Value]], Value]:
    def made(values: Sequence[Value]) -> Value:
        value, sizes = fill(values)
        return np.full([int(float(one.item())) for one in sizes], value.item(), dtype=object)

    return made


def _library(name: str) -> Callable[[Sequence[Value]], Value]:
    return lambda values: _map(lambda *texts: f"{name}({', '.join(texts)})", *values)


_BUILT_IN: dict[str, Callable[[Sequence[Value]], Value]] = {
    **{name: _library(in_c) for name, in_c in (FUNCTIONS | STEPS).items()},
    "sign": _library("sign_of"),
    "Integer": lambda v: v[0],
    "noEvent": lambda v: v[0],
    "smooth": lambda v: v[1],
    "div": lambda v: _map(lambda a, b: f"trunc({a} / {b})", *v),
    "mod": lambda v: _map(lambda a, b: f"({a} - floor({a} / {b}) * {b})", *v),
    "rem": lambda v: _map(lambda a, b: f"fmod({a}, {b})", *v),
    "min": _folded("fmin"),
    "max": _folded("fmax"),
    "sum": lambda v: _as_value(f"({' + '.join(map(str, v[0].ravel())) or '0'})"),
    "product": lambda v: _as_value(f"({' * '.join(map(str, v[0].ravel())) or '1'})"),
    "zeros": _sized(lambda v: (_as_value("0.0"), v)),
    "ones": _sized(lambda v: (_as_value("1.0"), v)),
    "fill": _sized(lambda v: (v[0], v[1:])),
    "transpose": lambda v: v[0].T,
}  # fmt: skip


def _made(source: FunctionSource, known: Source, shapes: Sequence[tuple[int, ...]]) -> _Function:
    key = (source, tuple(shapes))
    if key not in _MADE:
        made = _MADE[key] = _Function(next(_numbers), source.name)
        try:
            _declared_outputs(source, made, shapes, known)
            _Writer(source, known, shapes, made)
        except BaseException:
            del _MADE[key]
            raise
    return _MADE[key]


def _declared_outputs(
    source: FunctionSource, made: _Function, shapes: Sequence[tuple[int, ...]], known: Source
) -> None:
    """Sizes of the outputs as a function that calls itself needs them: of scalars."""
    variables, _ = Parser(source).function()
    made.outputs = [() for one in variables if one.role == "output"]


def call(source: FunctionSource, known: Source, arguments: Sequence[Any]) -> list[Any]:
    """The outputs of a function for arguments of expressions.

    Args:
        known: text of a function by its qualified name.
        arguments: arrays of expressions, or one.
    Returns: an array of expressions for each output.
    Raises: BuildError for what has no form in C.
    """
    arrays = [np.asarray(one, dtype=object) for one in arguments]
    return as_call(_made(source, known, [one.shape for one in arrays]), arrays)


def as_call(made: _Function, arrays: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The outputs of a function for arrays of expressions."""
    flat = [one for array in arrays for one in array.ravel()]
    found, place = [], 0
    for shape in made.outputs:
        values = np.empty(shape, dtype=object)
        for index in np.ndindex(*shape):
            values[index] = ex.make(f"call:{made.number}:{place}", *flat)
            place += 1
        found.append(values)
    return found


def native(name: str, includes: str, lines: Sequence[str]) -> _Function:
    """A function of one result with the statements `lines` in C, after the text `includes`."""
    key = (name, includes, tuple(lines))
    if key not in _MADE:
        _MADE[key] = _Function(next(_numbers), name, [()], list(lines), includes=includes)
    return _MADE[key]


def _no_derivative(one: Expr, _: Sequence[Expr]) -> Expr:
    number = int(one.op.split(":")[1])
    name = next(made.name for made in _MADE.values() if made.number == number)
    raise ex.NoDerivative(f"the function {name}() has no derivative that can be written")


def _written(one: Expr, args: Sequence[str]) -> str:
    _, number, place = one.op.split(":")
    return f"call_{number}({place}, (const double[]){{{', '.join(args) or '0'}}})"


ex.OTHERS["call"] = ex.Other(_no_derivative, _written)


def function_code(used: Iterable[Expr]) -> list[str]:
    """C of the functions in expressions, and of those that they call."""
    by_number = {made.number: made for made in _MADE.values()}
    wanted = {int(one.op.split(":")[1]) for one in used if one.op.startswith("call:")}
    ahead, needed = list(wanted), set()
    while ahead:
        number = ahead.pop()
        if number in needed:
            continue
        needed.add(number)
        text = "\n".join(by_number[number].lines)
        ahead += [one for one in by_number if f"function_{one}(" in text]
    if not needed:
        return []
    includes = dict.fromkeys(by_number[one].includes for one in sorted(needed) if by_number[one].includes)
    lines = [
        *includes,
        _AT,
        *(f"static void function_{one}(const double *in, double *out);" for one in sorted(needed)),
    ]
    for number in sorted(needed):
        made = by_number[number]
        size = sum(int(np.prod(one, dtype=int)) for one in made.outputs)
        body = "\n    ".join(made.lines)
        lines.append(f"""
static void function_{number}(const double *in, double *out) /* {made.name} */
{{
    int bad = 0;
    (void)in;
    {body}
}}
""")
        if number in wanted:
            lines.append(f"""static double call_{number}(int place, const double *in)
{{
    double out[{max(size, 1)}];
    function_{number}(in, out);
    return out[place];
}}
""")
    return lines


_AT = """/* Place of a subscript in an array of n elements. */
static inline int at_(double i, int n, int *bad)
{
    if (i >= 1 && i <= n) return (int)i - 1;
    *bad = 1;
    return 0;
}
"""
