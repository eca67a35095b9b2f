"""Generate the model.c of a traced component: CasADi's C, tables and messages, for stepped/stepmodel.h."""

from __future__ import annotations

import re

import casadi as ca

from orchestrator.base.errors import BuildError

from .component import ComponentProgram, StepVariable
from .generate import equations_in_c, work_array
from .package import TOKEN_MARK, c_string

_KINDS = {"float": "NUMBER_FLOAT", "int": "NUMBER_INT", "bool": "NUMBER_BOOL"}
_TYPES = {"float": "TYPE_REAL", "int": "TYPE_INTEGER", "bool": "TYPE_BOOLEAN"}
_FORMAT = re.compile(r"(\.\d+)?[efgEG]\Z")


def generate_step_c(program: ComponentProgram) -> str:
    """Return the text of model.c, with `TOKEN_MARK` where the token goes."""
    functions = [
        program.setup,
        program.initialise,
        program.advance,
        program.algebraics,
        program.tangent,
        program.arguments,
    ]
    equations = equations_in_c(functions)
    counts = [len(program.of_kind(kind)) for kind in ("STATE", "INPUT", "PARAMETER", "ALGEBRAIC")]
    info = ", ".join(map(str, (len(program.variables) + 1, *counts, 0, 0, 0)))
    lines = "\n".join(f"    {_entry(program, variable)}," for variable in program.variables)
    statuses = ", ".join(outcome.status for outcome in program.outcomes)
    return f"""/* {program.name}: generated from its Python source, not to be edited. */
#include "runtime.h"
#include "stepmodel.h"

{equations}

const ModelInfo model_info = {{{c_string(program.name)}, {c_string(TOKEN_MARK)}, {info}}};

const ModelVariable model_variables[] = {{
{lines}
    {{"time", KIND_TIME, 0, TYPE_REAL, 0, 0.0, 1.0}},
}};

#define POINT(at) &(at)->time, &(at)->step_size, (at)->x, (at)->u, (at)->p

{_transition(program.setup, "step_set_up")}
{_transition(program.initialise, "step_initialise")}
{_transition(program.advance, "step_advance")}
void model_algebraics(const ModelPoint *at, double *w) {{
    const double *arguments[{program.algebraics.sz_arg()}] = {{&at->time, 0, at->x, at->u, at->p}};
    double *results[{program.algebraics.sz_res()}] = {{w}};
    {work_array(program.algebraics)}
    algebraics(arguments, results, 0, work, 0);
}}

void model_tangent(const ModelPoint *at, const ModelPoint *seed, double *xdot, double *w, double *operand) {{
    const double *arguments[{program.tangent.sz_arg()}] = {{
        &at->time, 0, at->x, at->u, at->p, seed->x, seed->u
    }};
    double *results[{program.tangent.sz_res()}] = {{w}};
    {work_array(program.tangent)}
    (void)xdot;
    (void)operand;
    tangent(arguments, results, 0, work, 0);
}}

int step_status(int outcome) {{
    static const int statuses[] = {{{statuses}}};
    return statuses[outcome];
}}

void step_message(int outcome, const StepPoint *at, const char *name, Text *text) {{
    double values[{max(1, program.arguments.size1_out(0))}];
    const double *arguments[{program.arguments.sz_arg()}] = {{POINT(at)}};
    double *results[{program.arguments.sz_res()}] = {{values}};
    {work_array(program.arguments)}
    spoken_of(arguments, results, 0, work, 0);
    switch (outcome) {{
{_messages(program)}    default: break;
    }}
    (void)name;
    (void)text;
}}
"""


def _entry(program: ComponentProgram, variable: StepVariable) -> str:
    settable = variable.kind != "ALGEBRAIC" and variable.name not in program.set_up
    return (
        f"{{{c_string(variable.name)}, KIND_{variable.kind}, {variable.index}, {_TYPES[variable.type]}, "
        f"{int(settable)}, {variable.start or 0.0!r}, 1.0}}"
    )


def _transition(function: ca.Function, name: str) -> str:
    return f"""int {name}(const StepPoint *at, double *x) {{
    double outcome = 0;
    const double *arguments[{function.sz_arg()}] = {{POINT(at)}};
    double *results[{function.sz_res()}] = {{x, &outcome}};
    {work_array(function)}
    {function.name()}(arguments, results, 0, work, 0);
    return (int)outcome;
}}
"""


def _messages(program: ComponentProgram) -> str:
    found = []
    for number, outcome in enumerate(program.outcomes):
        if number:
            body = "\n".join(_text(program, outcome.text, "        "))
            found.append(f"    case {number}:\n{body}\n        break;\n")
    return "".join(found)


def _text(program: ComponentProgram, text: str, indent: str) -> list[str]:
    """Statements that write a text."""
    lines: list[str] = []
    for part in program.tape.parts(text):
        if isinstance(part, str):
            lines.append(f"{indent}text_add(text, {c_string(part)});")
        elif part[0] == "name":
            lines.append(f"{indent}text_add(text, name);")
        elif part[0] == "number":
            value = f"values[{program.spoken[part[1].number]}]"
            if not part[2]:
                lines.append(f"{indent}text_number(text, {value}, {_KINDS[part[1].kind]});")
            elif _FORMAT.match(part[2]):
                lines.append(f"{indent}text_format(text, {c_string('%' + part[2])}, {value});")
            else:
                raise BuildError(
                    f"{program.name}: native form: format {part[2]!r} in a message; allowed: none, or one "
                    "such as .3g, .2f, .1e"
                )
        else:
            lines.append(f"{indent}if (values[{program.spoken[part[1].number]}] != 0) {{")
            lines += _text(program, part[2], indent + "    ")
            other = _text(program, part[3], indent + "    ")
            lines += [f"{indent}}} else {{", *other] if other else []
            lines.append(f"{indent}}}")
    return lines
