"""The functions of a solved model, as they are checked and as they are generated to C."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from .causalise import SolvedModel


@dataclass(frozen=True)
class Program:
    """CasADi functions with the arguments t, x, u, p, d, m of `model.h`, and the order of their elements.

    Attributes:
        model: the solved model.
        states, inputs, parameters, algebraics: names in the order of x, u, p and w. Constants are
            among the parameters, so that they can be read; the equations hold their values.
        dependent_parameters: p -> every dependent parameter, in the order of `dependent`.
        dependent_starts: p -> every start value that depends on parameters, in the order of `started`.
        delay_maxima: p -> the longest delay time of every delay in `bounded` (numbers of delays).
        derivatives, algebraic, delays, relations, assertions: as in model.h; delays gives operands, times.
        tangent: (t, x, u, p, d, m, and the variations of t, x, u, p, d) -> variations of x', w, operands.
    """

    model: SolvedModel
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    algebraics: tuple[str, ...]
    dependent: tuple[str, ...]
    started: tuple[str, ...]
    bounded: tuple[int, ...]
    dependent_parameters: ca.Function
    dependent_starts: ca.Function
    delay_maxima: ca.Function
    derivatives: ca.Function
    algebraic: ca.Function
    delays: ca.Function
    relations: ca.Function
    assertions: ca.Function
    tangent: ca.Function


def build_program(model: SolvedModel) -> Program:
    """Gather a solved model's expressions into functions.

    Every output is dense: the generated C would leave structural zeros unwritten.
    """
    symbols = model.symbols
    parameters = {
        variable.name: symbols.parameters.get(variable.name, ca.SX.sym(variable.name))
        for variable in symbols.flat.variables
        if variable.name in symbols.parameters or variable.name in symbols.constants
    }
    groups = [
        [symbols.time],
        list(symbols.states.values()),
        list(symbols.inputs.values()),
        list(parameters.values()),
        [delay.symbol for delay in model.delays],
        [relation.symbol for relation in model.relations],
    ]
    arguments = [_column(group) for group in groups]
    derivatives = [model.derivatives[name] for name in symbols.states]
    algebraics = [model.algebraics[name] for name in symbols.algebraics]
    operands = [delay.operand for delay in model.delays]

    dependent: dict[str, ca.SX] = {}
    for name, expression in symbols.dependent.items():
        known = [symbols.parameters[other] for other in dependent]
        dependent[name] = ca.substitute([expression], known, list(dependent.values()))[0]
    started = {name: start for name, start in symbols.starts.items() if ca.symvar(start)}

    seeds = [[ca.SX.sym(f"seed_{element.name()}") for element in group] for group in groups[:5]]
    varied = [
        ca.jtimes(_column(results), ca.vertcat(*arguments[:5]), ca.vertcat(*map(_column, seeds)))
        for results in (derivatives, algebraics, operands)
    ]
    p = arguments[3]
    return Program(
        model=model,
        states=tuple(symbols.states),
        inputs=tuple(symbols.inputs),
        parameters=tuple(parameters),
        algebraics=tuple(symbols.algebraics),
        dependent=tuple(dependent),
        started=tuple(started),
        bounded=tuple(number for number, delay in enumerate(model.delays) if delay.maximum is not None),
        dependent_parameters=_function("dependent_parameters", [p], [list(dependent.values())]),
        dependent_starts=_function("dependent_starts", [p], [list(started.values())]),
        delay_maxima=_function(
            "delay_maxima", [p], [[delay.maximum for delay in model.delays if delay.maximum is not None]]
        ),
        derivatives=_function("derivatives", arguments, [derivatives]),
        algebraic=_function("algebraics", arguments, [algebraics]),
        delays=_function("delays", arguments, [operands, [delay.time for delay in model.delays]]),
        relations=_function("relations", arguments, [[relation.expression for relation in model.relations]]),
        assertions=_function("assertions", arguments, [model.assertions]),
        tangent=_function("tangent", [*arguments, *map(_column, seeds)], [[part] for part in varied]),
    )


def _column(elements: list[ca.SX]) -> ca.SX:
    return ca.vertcat(*elements) if elements else ca.SX.zeros(0, 1)


def _function(name: str, arguments: list[ca.SX], results: list[list[ca.SX]]) -> ca.Function:
    return ca.Function(name, arguments, [ca.densify(_column(result)) for result in results])
