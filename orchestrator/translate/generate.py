"""Generate model.c: CasADi's C for the equations, inside the tables and functions of runtime/model.h."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

import casadi as ca

from .flat import TIME, Assertion, Literal, Role, Type, Variable
from .interpreter import derivative_key, evaluate
from .package import TOKEN_MARK, c_string
from .program import Program


@dataclass(frozen=True)
class TableEntry:
    """One line of model_variables; its position is the value reference.

    Attributes:
        name: of the variable, or der(name).
        kind: constant of ModelKind without KIND_.
        index: position in x, x', u, p or w.
        type: Modelica type.
        settable: by the importer.
        start: None where the value is computed.
        nominal: of states.
        variable: its declaration; None for time.
        constant: a constant of the model.
    """

    name: str
    kind: str
    index: int
    type: Type
    settable: bool
    start: float | None
    nominal: float = 1.0
    variable: Variable | None = None
    constant: bool = False


def variable_table(program: Program) -> tuple[TableEntry, ...]:
    """Return the variables in the order of their value references: time, declared variables, derivatives."""
    symbols = program.model.symbols
    entries = [TableEntry(TIME, "TIME", 0, Type.REAL, False, None)]
    for variable in symbols.flat.variables:
        name = variable.name
        nominal = abs(variable.nominal) if variable.nominal else 1.0
        if name in symbols.states:
            start = None if name in program.started else float(symbols.starts[name])
            entries.append(
                TableEntry(
                    name,
                    "STATE",
                    program.states.index(name),
                    Type.REAL,
                    start is not None,
                    start,
                    nominal,
                    variable,
                )
            )
        elif name in symbols.inputs:
            start = float(evaluate(variable.start or Literal(0.0), symbols.constants))
            entries.append(
                TableEntry(
                    name, "INPUT", program.inputs.index(name), variable.type, True, start, nominal, variable
                )
            )
        elif variable.role in (Role.PARAMETER, Role.CONSTANT):
            constant = variable.role is Role.CONSTANT
            computed = name in program.dependent
            start = None if computed else float(evaluate(variable.binding or Literal(0.0), symbols.constants))
            settable = not (constant or computed or variable.final or variable.protected)
            entries.append(
                TableEntry(
                    name,
                    "PARAMETER",
                    program.parameters.index(name),
                    variable.type,
                    settable,
                    start,
                    1.0,
                    variable,
                    constant,
                )
            )
        else:
            entries.append(
                TableEntry(
                    name,
                    "ALGEBRAIC",
                    program.algebraics.index(name),
                    variable.type,
                    False,
                    None,
                    1.0,
                    variable,
                )
            )
    declared = {variable.name: variable for variable in symbols.flat.variables}
    for index, name in enumerate(program.states):
        entries.append(
            TableEntry(derivative_key(name), "DERIVATIVE", index, Type.REAL, False, None, 1.0, declared[name])
        )
    return tuple(entries)


def generate_c(program: Program, identifier: str) -> str:
    """Return the text of model.c, with `TOKEN_MARK` where the token goes.

    Args:
        program: the functions of the model.
        identifier: model identifier, a C identifier.
    """
    functions = [
        *([program.dependent_parameters] if program.dependent else []),
        *([program.dependent_starts] if program.started else []),
        *([program.delay_maxima] if program.bounded else []),
        program.derivatives,
        program.algebraic,
        program.delays,
        program.relations,
        program.assertions,
        program.tangent,
    ]
    equations = equations_in_c(functions)
    table = variable_table(program)
    flat = program.model.symbols.flat
    strict = [str(int(relation.strict)) for relation in program.model.relations] or ["0"]
    messages = [c_string(_message(assertion)) for assertion in flat.assertions] or ['""']
    errors = [str(int(assertion.error)) for assertion in flat.assertions] or ["0"]
    info = ", ".join(
        str(count)
        for count in (
            len(table),
            len(program.states),
            len(program.inputs),
            len(program.parameters),
            len(program.algebraics),
            len(program.model.delays),
            len(program.model.relations),
            len(flat.assertions),
        )
    )
    lines = "\n".join(f"    {_entry(entry)}," for entry in table)
    return f"""/* Equations of {flat.name}: generated, not to be edited. */
#include "model.h"

{equations}

const ModelInfo model_info = {{{c_string(identifier)}, {c_string(TOKEN_MARK)}, {info}}};

const ModelVariable model_variables[] = {{
{lines}
}};

const int model_relation_strict[] = {{{", ".join(strict)}}};
const char *const model_assertion_messages[] = {{{", ".join(messages)}}};
const int model_assertion_is_error[] = {{{", ".join(errors)}}};

{_parameter_functions(program)}

#define POINT(at) &(at)->time, (at)->x, (at)->u, (at)->p, (at)->d, (at)->m

{_wrapper(program.derivatives, "model_derivatives", "double *xdot", ["xdot"])}
{_wrapper(program.algebraic, "model_algebraics", "double *w", ["w"])}
{_wrapper(program.delays, "model_delays", "double *operand, double *delay_time", ["operand", "delay_time"])}
{_wrapper(program.relations, "model_relations", "double *r", ["r"])}
{_wrapper(program.assertions, "model_assertions", "double *a", ["a"])}
void model_tangent(const ModelPoint *at, const ModelPoint *seed, double *xdot, double *w, double *operand) {{
    const double *arguments[{program.tangent.sz_arg()}] = {{
        POINT(at), &seed->time, seed->x, seed->u, seed->p, seed->d
    }};
    double *results[{program.tangent.sz_res()}] = {{xdot, w, operand}};
    {work_array(program.tangent)}
    tangent(arguments, results, 0, work, 0);
}}
"""


def _wrapper(function: ca.Function, name: str, parameters: str, results: list[str]) -> str:
    return f"""void {name}(const ModelPoint *at, {parameters}) {{
    const double *arguments[{function.sz_arg()}] = {{POINT(at)}};
    double *results[{function.sz_res()}] = {{{", ".join(results)}}};
    {work_array(function)}
    {function.name()}(arguments, results, 0, work, 0);
}}
"""


def _parameter_functions(program: Program) -> str:
    """The three functions that read parameters alone and fill part of an array."""
    unbounded = [number for number in range(len(program.model.delays)) if number not in program.bounded]
    return "\n".join(
        (
            _filler(
                program.dependent_parameters,
                "model_dependent_parameters(double *p)",
                "p",
                [program.parameters.index(name) for name in program.dependent],
            ),
            _filler(
                program.dependent_starts,
                "model_dependent_starts(const double *p, double *x)",
                "x",
                [program.states.index(name) for name in program.started],
            ),
            _filler(
                program.delay_maxima,
                "model_delay_maxima(const double *p, double *maximum)",
                "maximum",
                list(program.bounded),
                [f"maximum[{number}] = INFINITY;" for number in unbounded],
            ),
        )
    )


def _filler(
    function: ca.Function, signature: str, target: str, places: list[int], more: Sequence[str] = ()
) -> str:
    lines = list(more)
    if places:
        lines += [
            f"double values[{len(places)}];",
            f"const double *arguments[{function.sz_arg()}] = {{p}};",
            f"double *results[{function.sz_res()}] = {{values}};",
            work_array(function),
            f"{function.name()}(arguments, results, 0, work, 0);",
            *(f"{target}[{place}] = values[{i}];" for i, place in enumerate(places)),
        ]
    else:
        lines += [f"(void){name};" for name in dict.fromkeys(("p", target)) if f"*{name}" in signature]
    body = "\n".join(f"    {line}" for line in lines)
    return f"void {signature} {{\n{body}\n}}\n"


def work_array(function: ca.Function) -> str:
    """Declare the memory that the C code of a function works in."""
    return f"double work[{max(1, function.sz_w())}];"


def _entry(entry: TableEntry) -> str:
    type_name = {Type.REAL: "TYPE_REAL", Type.INTEGER: "TYPE_INTEGER", Type.BOOLEAN: "TYPE_BOOLEAN"}[
        entry.type
    ]
    start = 0.0 if entry.start is None else entry.start
    return (
        f"{{{c_string(entry.name)}, KIND_{entry.kind}, {entry.index}, {type_name}, {int(entry.settable)}, "
        f"{start!r}, {entry.nominal!r}}}"
    )


def _message(assertion: Assertion) -> str:
    # Without folders: the text has to be the same wherever the sources lie.
    return f"{assertion.message} ({PurePosixPath(assertion.location.file).name}:{assertion.location.line})"


def equations_in_c(functions: Sequence[ca.Function]) -> str:
    """CasADi's C without what only states at run time how it is called, and with local names."""
    generator = ca.CodeGenerator("equations", {"with_export": False, "with_header": False})
    for function in functions:
        generator.add(function)
    text = generator.dump()
    text = text[text.index("#include <math.h>") :]
    text = re.sub(
        r"/\* Configuration this file.*?(?=static const casadi_int|/\* \w+:)", "", text, flags=re.DOTALL
    )
    for name in (function.name() for function in functions):
        # From the first of a function's helpers up to the next function's comment or the end.
        text = re.sub(
            rf"^int {name}_checkout\(void\).*?(?=^/\* \w+:|\Z)", "", text, flags=re.DOTALL | re.MULTILINE
        )
        text = re.sub(rf"^int {name}\(", f"static int {name}(", text, flags=re.MULTILINE)
    # Patterns of sparsity; dense functions do not use them.
    text = re.sub(r"^static const casadi_int casadi_s\d+\[.*?;\n", "", text, flags=re.MULTILINE)
    text = re.sub(r"^#define casadi_s\d+ .*\n", "", text, flags=re.MULTILINE)
    text = re.sub(r"^(casadi_(?:real|int) casadi_\w+\()", r"static \1", text, flags=re.MULTILINE)
    return text.replace(
        "/* Add prefix", "#define CASADI_PREFIX(ID) equations_ ## ID\n\n/* Add prefix"
    ).strip()
