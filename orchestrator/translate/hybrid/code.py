"""The model.c of a hybrid model: tables and functions for runtime/hybrid/hybrid.h."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import accumulate

from ..package import TOKEN_MARK, c_string
from . import expression as ex
from .expression import Expr
from .form import refused
from .functions import function_code
from .layout import Layout, Port, margins_of, reported_actions
from .matching import Block
from .model import Action, DaeModel
from .sparsity import colours_of, columns_of, factors_of
from .structure import System
from .tables import table_code

_INFIX = {
    "add": "+", "sub": "-", "mul": "*", "div": "/", "lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==",
    "ne": "!=", "and": "&&", "or": "||",
}  # fmt: skip
_KINDS = {
    "assert": "ACTION_ASSERT", "warning": "ACTION_WARNING", "terminate": "ACTION_TERMINATE",
    "bound": "ACTION_BOUND",
}  # fmt: skip
_TYPES = {"real": "TYPE_REAL", "boolean": "TYPE_BOOLEAN"}


class _Writer:
    """Statements that compute expressions, what they share once."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self.others: dict[Expr, None] = {}

    def reference(self, one: Expr) -> str:
        layout, kind = self._layout, one.args[0]
        if kind in ("t", "initial", "homotopy"):
            return f"h->{kind}"
        if kind == "delayed":
            return f"hybrid_delayed(h, {one.args[1]})"
        if kind == "rise":
            return f"(h->rise[{one.args[1]}] != 0)"
        if kind == "tick":
            return f"h->tick[{one.args[1]}]"
        if kind == "mode":
            return f"h->z[{layout.mode_slot + one.args[1]}]"
        if one in layout.inputs:
            return f"h->u[{layout.inputs[one]}]"
        if one in layout.parameters:
            return f"h->p[{layout.parameters[one]}]"
        if kind == "pre" and one not in layout.slots:  # of an alias or an input: as it is
            value = ex.symbol("v", one.args[1])
            return self.reference(layout.system.aliases.get(value, value))
        if kind == "text":
            raise refused(layout.system.model.name, f"the text {one.args[1]!r} in an expression")
        return f"h->z[{layout.slots[one]}]"

    def statements(self, targets: Sequence[tuple[str, Expr]], indent: str = "    ") -> list[str]:
        """Assignments of expressions to places."""
        uses: dict[int, int] = {}
        nodes = list(ex.postorder(*(value for _, value in targets)))
        for one in nodes:
            for arg in one.args:
                if isinstance(arg, Expr):
                    uses[id(arg)] = uses.get(id(arg), 0) + 1
        texts: dict[int, str] = {}
        depth: dict[int, int] = {}
        lines = []
        for one in nodes:
            text = self._text(one, texts)
            deep = 1 + max((depth[id(a)] for a in one.args if isinstance(a, Expr)), default=0)
            if one.op not in ("num", "sym") and (uses.get(id(one), 0) > 1 or deep > 30):
                name = f"c{len(lines)}"
                lines.append(f"{indent}const double {name} = {text};")
                text, deep = name, 0
            texts[id(one)], depth[id(one)] = text, deep
        return [*lines, *(f"{indent}{place} = {texts[id(value)]};" for place, value in targets)]

    def _text(self, one: Expr, texts: dict[int, str]) -> str:
        if one.op == "num":
            text = repr(float(one.args[0]))
            text = {"inf": "INFINITY", "-inf": "-INFINITY", "nan": "NAN"}.get(text, text)
            return f"({text})" if text.startswith("-") else text
        if one.op == "sym":
            return self.reference(one)
        args = [texts[id(a)] for a in one.args if isinstance(a, Expr)]
        if (other := ex.OTHERS.get(one.op.partition(":")[0])) is not None:
            self.others[one] = None
            return other.written(one, args)
        if one.op in _INFIX:
            return f"({args[0]} {_INFIX[one.op]} {args[1]})"
        match one.op:
            case "neg":
                return f"(-{args[0]})"
            case "not":
                return f"(!({args[0]} != 0))"
            case "if":
                return f"({args[0]} != 0 ? {args[1]} : {args[2]})"
            case "fn:sign":
                return f"sign_of({args[0]})"
        return f"{one.op[3:]}({', '.join(args)})"


def generate_hybrid_c(layout: Layout, identifier: str) -> str:
    """Return the text of model.c, with `TOKEN_MARK` where the token goes."""
    system, writer = layout.system, _Writer(layout)
    model = system.model
    parts = [
        _blocks(system.blocks, "block", writer, layout),
        _blocks(system.initial_blocks, "initial", writer, layout),
        _function("void hybrid_dependents(const Hybrid *h)", writer.statements(_dependents(layout, writer))),
        _function(
            "void hybrid_modes(const Hybrid *h, double *m)",
            writer.statements([(f"m[{n}]", one) for n, one in enumerate(model.modes)]),
            "m",
        ),
        _function(
            "void hybrid_margins(const Hybrid *h, double *g)",
            writer.statements([(f"g[{n}]", one) for n, one in enumerate(margins_of(model.modes))]),
            "g",
        ),
        _conditions(layout, writer),
        _discretes(layout, writer),
        _reinits(layout, writer),
        _actions(layout, writer),
        _contradiction(layout, writer),
        _function(
            "void hybrid_constraints(const Hybrid *h, double *r)",
            writer.statements([(f"r[{n}]", one) for n, one in enumerate(system.constraints)]),
            "r",
        ),
        _function(
            "void hybrid_outputs(const Hybrid *h, double *w)",
            writer.statements([(f"w[{n}]", one.value) for n, one in enumerate(layout.computed) if one.value]),
            "w",
        ),
    ]
    delays = [(f"operands[{n}]", one.operand) for n, one in enumerate(model.delays)]
    delays += [(f"lags[{n}]", one.lag) for n, one in enumerate(model.delays)]
    head = "void hybrid_delays(const Hybrid *h, double *operands, double *lags)"
    parts.append(_function(head, writer.statements(delays), "operands", "lags"))
    parts = [*table_code(writer.others), *function_code(writer.others), *parts]
    token = c_string(TOKEN_MARK)
    counts = (len(layout.ports), layout.n_z, len(layout.inputs), len(layout.parameters), len(layout.computed))
    lines = "\n".join(f"    {_entry(one)}," for one in layout.ports)
    body = "\n".join(parts)
    return f"""/* {model.name}: generated from its Modelica source, not to be edited. */
#include <math.h>

#include "hybrid.h"
#include "model.h"

static inline double sign_of(double x)
{{
    return (x > 0) - (x < 0);
}}

const ModelInfo model_info = {{{c_string(identifier)}, {token}, {", ".join(map(str, counts))}, 0, 0, 0}};

const ModelVariable model_variables[] = {{
{lines}
}};

{body}
{_tables(layout)}
"""


def _entry(port: Port) -> str:
    kind = "TYPE_REAL" if port.scalar is None or port.order else _TYPES.get(port.scalar.type, "TYPE_INTEGER")
    settable = int(port.start is not None)
    start = port.start or 0.0
    return f"{{{c_string(port.name)}, KIND_{port.kind}, {port.index}, {kind}, {settable}, {start!r}, 1.0}}"


def _function(head: str, lines: Sequence[str], *unused: str) -> str:
    ignored = [f"    (void){name};" for name in ("h", *unused)]
    return "\n".join([head, "{", *ignored, *lines, "}", ""])


def _blocks(blocks: Sequence[Block], name: str, writer: _Writer, layout: Layout) -> str:
    """Functions and table of blocks; neighbours that are solved already share one function."""
    functions: list[str] = []
    entries: list[str] = []
    waiting: list[tuple[str, Expr]] = []

    def close() -> None:
        if waiting:
            # One after the other: each may read what those before it have set.
            lines = [line for place, value in waiting for line in _braced(writer, place, value)]
            call = f"{name}_{len(entries)}_assign"
            functions.append(_function(f"static void {call}(const Hybrid *h)", lines))
            entries.append(f'{{0, 1, 0, {call}, 0, 0, ""}}')
            waiting.clear()

    for block in blocks:
        if block.value is not None:
            waiting.append((writer.reference(block.unknowns[0]), block.value))
            if len(waiting) >= 200:
                close()
            continue
        close()
        n, stem = len(block.unknowns), f"{name}_{len(entries)}"
        slots = ", ".join(str(layout.slots[one]) for one in block.unknowns)
        functions.append(f"static const int {stem}_slots[] = {{{slots}}};\n")
        inner = [line for one, value in block.inner for line in _braced(writer, writer.reference(one), value)]
        residuals = writer.statements([(f"r[{k}]", one) for k, one in enumerate(block.residuals)])
        head = f"static void {stem}_residuals(const Hybrid *h, double *r)"
        functions.append(_function(head, [*inner, *residuals], "r"))
        jacobian = "0"
        if block.jacobian is not None:
            jacobian = f"{stem}_jacobian"
            cells = [
                (f"j[{r * n + c}]", one) for r, row in enumerate(block.jacobian) for c, one in enumerate(row)
            ]
            lines = writer.statements([one for one in cells if one[1] is not ex.ZERO])
            clear = f"    for (int k = 0; k < {n * n}; k++) j[k] = 0;"
            functions.append(
                _function(f"static void {jacobian}(const Hybrid *h, double *j)", [clear, *lines])
            )
        names = [layout.system.model.name_of(one) for one in block.unknowns]
        text = ", ".join(names[:8]) + (f" and {n - 8} more" if n > 8 else "")
        entries.append(
            f"{{{n}, {int(block.linear)}, {stem}_slots, 0, {stem}_residuals, {jacobian}, {c_string(text)}}}"
        )
    close()
    table = ",\n    ".join(entries) or '{0, 1, 0, 0, 0, 0, ""}'
    functions.append(
        f"static const HybridBlock {name}_table[] = {{\n    {table}\n}};\n#define N_{name} {len(entries)}\n"
    )
    return "\n".join(functions)


def _braced(writer: _Writer, place: str, value: Expr) -> list[str]:
    """One assignment in a scope of its own."""
    lines = writer.statements([(place, value)], "        ")
    return [f"    {lines[0].strip()}"] if len(lines) == 1 else ["    {", *lines, "    }"]


def _dependents(layout: Layout, writer: _Writer) -> list[tuple[str, Expr]]:
    """Dependent parameters in the order of their needs, then start values that depend on parameters."""
    variables = layout.system.model.variables
    known: dict[int, Expr] = {}
    bindings = {one.value: one.binding for one in variables if one.role == "dependent" and one.binding}
    for _ in range(len(bindings)):
        reduced = {one: ex.substituted(value, bindings) for one, value in bindings.items()}
        if reduced == bindings:
            break
        bindings = reduced
    free = {one.value for one in variables if one.role == "free"}
    targets = [(writer.reference(one), value) for one, value in bindings.items() if not value.free & free]
    settable = {start for _, start, _ in layout.settable}
    for one in variables:
        start = ex.symbol("start", one.value.args[1])
        if start in layout.slots and layout.slots[start] not in settable:
            value = ex.substituted(one.start, bindings, known)
            targets.append((writer.reference(start), value))
    return targets


def _conditions(layout: Layout, writer: _Writer) -> str:
    lines = []
    for number, one in enumerate(layout.system.model.conditions):
        rise = f"(c[{number}] != 0 && before[{number}] == 0)"
        a, b = (*one.operands, 0, 0)[:2]
        match one.kind:
            case "always":
                value, rise = "1", "1"
            case "initial":
                value, rise = "h->initial", "h->initial"
            case "clock":
                value, rise = f"h->tick[{a}]", f"h->tick[{a}]"
            case "not":
                value = f"(c[{a}] == 0)"
            case "and":
                value = f"(c[{a}] != 0 && c[{b}] != 0)"
            case "or":
                value = f"(c[{a}] != 0 || c[{b}] != 0)"
            case "rise":
                value, rise = f"(c[{a}] != 0 || c[{b}] != 0)", f"(rise[{a}] != 0 || rise[{b}] != 0)"
            case _:
                lines += [
                    "    {",
                    *writer.statements([(f"c[{number}]", one.operands[0])], "        "),
                    "    }",
                ]
                value = ""
        if value:
            lines.append(f"    c[{number}] = {value};")
        # While the model starts, nothing rises but initial(), alone or as an element of a when's vector.
        held = "" if one.kind in ("initial", "always", "rise") else "!h->initial && "
        lines.append(f"    rise[{number}] = {held}{rise};")
    return _function(
        "void hybrid_conditions(const Hybrid *h, const double *before, double *c, double *rise)", lines,
        "before", "c", "rise",
    )  # fmt: skip


def _rises(one: Action, model: DaeModel) -> bool:
    """Whether an action counts at the moment alone at which a condition rises."""
    by_value = one.value is not None and any(symbol.args[0] == "rise" for symbol in one.value.free)
    return by_value or (one.trigger is not None and model.conditions[one.trigger].kind != "always")


def _active(trigger: int, guard: int | None) -> str:
    return f"h->rise[{trigger}] != 0" + ("" if guard in (None, trigger) else f" && h->c[{guard}] != 0")


def _discretes(layout: Layout, writer: _Writer) -> str:
    lines: list[str] = []
    model = layout.system.model
    for one in model.discretes:
        place = writer.reference(one.target)
        chain = ""
        always = False
        for branch in one.branches:
            always = branch.trigger is None
            head = f"{chain}{{" if always else f"{chain}if ({_active(branch.trigger or 0, branch.guard)}) {{"
            lines += [f"    {head}", *writer.statements([(place, branch.value)], "        "), "    }"]
            if always:
                break
            chain = "else "
        if not always:
            # Where the start of a parameter or variable is set by initial equations, that holds.
            before = writer.reference(ex.symbol("pre", one.target.args[1]))
            lines.append(f"    else {place} = {before};")
    initial = [
        (target, value)
        for target, value in model.initial_values
        if target in {d.target for d in model.discretes}
    ]
    if initial:
        lines.append("    if (h->initial) {")
        for target, value in initial:
            lines += [
                "        {",
                *writer.statements([(writer.reference(target), value)], "            "),
                "        }",
            ]
        lines.append("    }")
    return _function("void hybrid_discretes(const Hybrid *h)", lines)


def _reinits(layout: Layout, writer: _Writer) -> str:
    lines = ["    int set = 0;"]
    for one in layout.system.model.actions:
        if one.kind == "reinit" and one.target is not None and one.value is not None:
            lines += [
                f"    if ({_active(one.trigger, one.guard)}) {{",
                *writer.statements([(writer.reference(one.target), one.value)], "        "),
                "        set = 1;",
                "    }",
            ]
    return _function("int hybrid_reinits(const Hybrid *h)", [*lines, "    return set;"])


def _actions(layout: Layout, writer: _Writer) -> str:
    lines = []
    for number, one in enumerate(reported_actions(layout.system)):
        active = "1" if one.trigger is None else _active(one.trigger, one.guard)
        if one.value is not None:
            lines += [
                "    {",
                *writer.statements([("const double holds", one.value)], "        "),
                f"        a[{number}] = {active} && holds == 0;",
                "    }",
            ]
        else:
            lines.append(f"    a[{number}] = {active};")
    return _function("void hybrid_actions(const Hybrid *h, double *a)", lines, "a")


def _contradiction(layout: Layout, writer: _Writer) -> str:
    lines = []
    for number, one in enumerate(layout.system.checks, 1):
        body = writer.statements([("const double holds", one.holds)], "        ")
        lines += ["    {", *body, f"        if (holds == 0) return {number};", "    }"]
    return _function("int hybrid_contradiction(const Hybrid *h)", [*lines, "    return 0;"])


def _array(kind: str, name: str, values: Iterable[object]) -> str:
    found = ", ".join(map(str, values)) or "0"
    return f"static const {kind} {name}[] = {{{found}}};"


def _tables(layout: Layout) -> str:
    system, slots = layout.system, layout.slots
    model = system.model
    variables = model.variables
    before = [
        (slot, slots[ex.symbol("v", one.args[1])])
        for one, slot in slots.items()
        if one.args[0] == "pre" and ex.symbol("v", one.args[1]) in slots
    ]
    discrete = {one.value for one in variables if one.role == "discrete"}
    numbers = [one.args[1] for one in slots if one.args[0] == "pre" and ex.symbol("v", one.args[1]) in slots]
    started = [
        (slots[one.value], slots[ex.symbol("start", one.value.args[1])])
        for one in variables
        if one.value in slots and ex.symbol("start", one.value.args[1]) in slots
    ]
    reported = reported_actions(system)
    nominals = [variables[one.args[1]].nominal for one in system.states]
    arrays = [
        _array("int", "states", (slots[one] for one in system.states)),
        _array("int", "slopes", (slots[ex.symbol("der", one.args[1], 1)] for one in system.states)),
        _array("double", "nominals", (repr(one) for one in nominals)),
        _array("char *const", "mode_names", (c_string(_mode(one, layout)) for one in model.modes)),
        _array("int", "mode_margins", _margins_of_relations(model.modes)),
        _array("char *const", "delayed_names", (c_string(one.shown) for one in model.delays)),
        _array("char *const", "checked", (c_string(one.shown) for one in system.checks)),
        _array("double", "phases", (repr(one) for one, _ in model.clocks)),
        _array("double", "periods", (repr(one) for _, one in model.clocks)),
        _array("double", "instants", map(repr, model.instants)),
        _array("int", "pre", (one for one, _ in before)),
        _array("int", "pre_of", (one for _, one in before)),
        _array("int", "discretes", (slots[one.target] for one in model.discretes)),
        _array("int", "started", (one for one, _ in started)),
        _array("int", "starts", (one for _, one in started)),
        _array("int", "settable", (one for one, _, _ in layout.settable)),
        _array("int", "settable_starts", (one for _, one, _ in layout.settable)),
        _array("int", "settable_lasts", (one for _, _, one in layout.settable)),
        _array("int", "action_kinds", (_KINDS[one.kind] for one in reported)),
        _array("int", "action_rises", (int(_rises(one, model)) for one in reported)),
        _array("char *const", "messages", (c_string(one.message) for one in reported)),
    ]
    columns = columns_of(system)
    colours, factors = colours_of(columns), factors_of(columns)
    starts = [0, *accumulate(map(len, columns))]
    arrays += [
        _array("int", "colours", colours),
        _array("int", "column_starts", starts),
        _array("int", "rows", (row for rows in columns for row in rows)),
    ]
    if factors is not None:
        parts = [factors.order, factors.starts, factors.columns, factors.diagonals, factors.entries]
        names = ["factor_order", "factor_starts", "factor_columns", "factor_diagonals", "factor_entries"]
        arrays += [_array("int", name, values) for name, values in zip(names, parts, strict=True)]
        fields = ", ".join([str(len(factors.columns)), *names])
        arrays.append(f"static const HybridFactors factors = {{{fields}}};")
    arrays = [line.replace("{0}", '{""}') if "char" in line else line for line in arrays]
    values = [
        layout.n_z, len(system.states), "states", "slopes", "nominals", "N_block", "N_initial", "block_table",
        "initial_table", len(model.modes), layout.mode_slot, "mode_names", len(model.conditions),
        layout.condition_slot, len(model.clocks), layout.clock_slot, "phases", "periods", len(model.instants),
        "instants", len(before), sum(ex.symbol("v", one) in discrete for one in numbers), "pre", "pre_of",
        len(model.discretes), "discretes", len(started), "started",
        "starts", len(layout.settable), "settable", "settable_starts", "settable_lasts", len(reported),
        layout.warned_slot, "action_kinds", "action_rises", "messages", len(system.constraints),
        layout.done_slot, layout.size_slot, len(margins_of(model.modes)), "mode_margins",
        layout.use_slot, layout.use_slot + 1, layout.use_slot + 2,
        int(any(ex.symbol("homotopy") in one.free for one in _initial_expressions(system))),
        max(colours, default=-1) + 1, "colours", "column_starts", "rows", "&factors" if factors else "0",
        len(model.delays), layout.history_slot, "delayed_names", "checked",
    ]  # fmt: skip
    return "\n".join([*arrays, f"const HybridInfo hybrid_info = {{{', '.join(map(str, values))}}};"])


def _initial_expressions(system: System) -> Iterator[Expr]:
    for block in system.initial_blocks:
        yield from (*block.residuals, *(value for _, value in block.inner))
        if block.value is not None:
            yield block.value


def _margins_of_relations(modes: Sequence[Expr]) -> list[int]:
    """For each mode the number of its margin; -1 of one that has two."""
    counts = [len(margins_of([one])) for one in modes]
    return [
        begin if count == 1 else -1 for begin, count in zip(accumulate([0, *counts]), counts, strict=False)
    ]


def _mode(one: Expr, layout: Layout) -> str:
    """A mode in words, for messages."""
    names = sorted(
        {
            layout.system.model.name_of(s) if s.args[0] != "t" else "time"
            for s in one.free
            if s.args[0] != "mode"
        }
    )
    return f"of {', '.join(names)}"
