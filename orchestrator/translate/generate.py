"""Generate model.c: CasADi's C for the equations, and the tables and functions of runtime/model.h around it."""

from __future__ import annotations

import re
from dataclasses import dataclass

import casadi as ca

from .flat import TIME, Literal, Role, Type, Variable
from .interpreter import derivative_key, evaluate
from .program import Program

TOKEN_MARK = "@TOKEN@"
"""Stands for the token in the generated text until the token, which depends on the text, is known."""


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
    """Return the variables in the order of their value references: time, then as declared, then derivatives."""
    symbols = program.model.symbols
    entries = [TableEntry(TIME, "TIME", 0, Type.REAL, False, None)]
    for variable in symbols.flat.variables:
        name = variable.name
        nominal = abs(variable.nominal) if variable.nominal else 1.0
        if name in symbols.states:
            start = None if name in program.started else float(symbols.starts[name])
            entries.append(
                TableEntry(name, "STATE", program.states.index(name), Type.REAL, start is not None, start, nominal, variable)
            )
        elif name in symbols.inputs:
            start = float(evaluate(variable.start or Literal(0.0), symbols.constants))
            entries.append(
                TableEntry(name, "INPUT", program.inputs.index(name), variable.type, True, start, nominal, variable)
            )
        elif variable.role in (Role.PARAMETER, Role.CONSTANT):
            constant = variable.role is Role.CONSTANT
            computed = name in program.dependent
            start = None if computed else float(evaluate(variable.binding or Literal(0.0), symbols.constants))
            settable = not (constant or computed or variable.final)
            entries.append(
                TableEntry(
                    name, "PARAMETER", program.parameters.index(name), variable.type, settable, start, 1.0, variable, constant
                )
            )
        else:
            entries.append(
                TableEntry(name, "ALGEBRAIC", program.algebraics.index(name), variable.type, False, None, 1.0, variable)
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
        program.dependent_parameters,
        program.dependent_starts,
        program.derivatives,
        program.algebraic,
        program.delays,
        program.relations,
        program.assertions,
        program.tangent,
    ]
    generator = ca.CodeGenerator("equations", {"with_export": False, "with_header": False})
    for function in functions:
        generator.add(function)
    equations = _trimmed(generator.dump(), [function.name() for function in functions])
    table = variable_table(program)
    flat = program.model.symbols.flat
    strict = [str(int(relation.strict)) for relation in program.model.relations] or ["0"]
    messages = [_string(f"{assertion.message} ({assertion.location})") for assertion in flat.assertions] or ['""']
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

const ModelInfo model_info = {{{_string(identifier)}, {_string(TOKEN_MARK)}, {info}}};

const ModelVariable model_variables[] = {{
{lines}
}};

const int model_relation_strict[] = {{{", ".join(strict)}}};
const char *const model_assertion_messages[] = {{{", ".join(messages)}}};
const int model_assertion_is_error[] = {{{", ".join(errors)}}};

{_dependents(program)}

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
    {_work(program.tangent)}
    tangent(arguments, results, 0, work, 0);
}}
"""


def _wrapper(function: ca.Function, name: str, parameters: str, results: list[str]) -> str:
    return f"""void {name}(const ModelPoint *at, {parameters}) {{
    const double *arguments[{function.sz_arg()}] = {{POINT(at)}};
    double *results[{function.sz_res()}] = {{{", ".join(results)}}};
    {_work(function)}
    {function.name()}(arguments, results, 0, work, 0);
}}
"""


def _dependents(program: Program) -> str:
    parts = []
    for function, signature, target, places in (
        (
            program.dependent_parameters,
            "void model_dependent_parameters(double *p)",
            "p",
            [program.parameters.index(name) for name in program.dependent],
        ),
        (
            program.dependent_starts,
            "void model_dependent_starts(const double *p, double *x)",
            "x",
            [program.states.index(name) for name in program.started],
        ),
    ):
        if not places:
            unused = "\n".join(f"    (void){name};" for name in ("p", "x") if f"*{name}" in signature)
            parts.append(f"{signature} {{\n{unused}\n}}\n")
            continue
        copies = "\n".join(f"    {target}[{place}] = values[{i}];" for i, place in enumerate(places))
        parts.append(
            f"""{signature} {{
    double values[{len(places)}];
    const double *arguments[{function.sz_arg()}] = {{p}};
    double *results[{function.sz_res()}] = {{values}};
    {_work(function)}
    {function.name()}(arguments, results, 0, work, 0);
{copies}
}}
"""
        )
    return "\n".join(parts)


def _work(function: ca.Function) -> str:
    return f"double work[{max(1, function.sz_w())}];"


def _entry(entry: TableEntry) -> str:
    type_name = {Type.REAL: "TYPE_REAL", Type.INTEGER: "TYPE_INTEGER", Type.BOOLEAN: "TYPE_BOOLEAN"}[entry.type]
    start = 0.0 if entry.start is None else entry.start
    return (
        f"{{{_string(entry.name)}, KIND_{entry.kind}, {entry.index}, {type_name}, {int(entry.settable)}, "
        f"{start!r}, {entry.nominal!r}}}"
    )


def _string(text: str) -> str:
    escaped = "".join(_escape(byte) for byte in text.encode())
    return f'"{escaped}"'


def _escape(byte: int) -> str:
    character = chr(byte)
    if character in '"\\?':
        return "\\" + character
    # Octal, three digits: a hexadecimal escape would swallow the characters behind it.
    return character if 32 <= byte < 127 else f"\\{byte:03o}"


def _trimmed(text: str, names: list[str]) -> str:
    """CasADi's C without the functions that describe each function to a caller at run time."""
    start = text.index("#include <math.h>")
    kept = text[start:]
    kept = re.sub(r"/\* Configuration this file.*?(?=static const casadi_int|/\* \w+:)", "", kept, flags=re.DOTALL)
    for name in names:
        # Up to the next function's comment or the end of the text.
        kept = re.sub(
            rf"^int {name}_checkout\(void\).*?(?=^/\* \w+:|\Z)", "", kept, flags=re.DOTALL | re.MULTILINE
        )
        kept = re.sub(rf"^int {name}\(", f"static int {name}(", kept, flags=re.MULTILINE)
    kept = re.sub(r"^(casadi_(?:real|int) casadi_\w+\()", r"static \1", kept, flags=re.MULTILINE)
    kept = kept.replace("CASADI_PREFIX(", "equations_PREFIX(")
    kept = kept.replace("/* Add prefix", "#define equations_PREFIX(ID) equations_ ## ID\n\n/* Add prefix")
    return kept.strip()
