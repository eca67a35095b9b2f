"""Linear systems of python-control or scipy -> Modelica text, and from that FMUs like any other."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..base.digests import digest_of
from ..base.errors import ConfigError, Problem
from ..base.temporary_folders import cache_folder, keep_last_used, scratch_folder

if TYPE_CHECKING:
    import control

    from .build_report import BuildReport

_NAME = re.compile(r"[A-Za-z]\w*")
_DEFAULT_LABEL = re.compile(r"([uyx])\[\d+\]")
_MOST_KEPT = 100  # FMUs, each of some 0.2 MB
_KINDS = "a StateSpace or TransferFunction of python-control, or a linear system of scipy.signal"


def is_linear(system: Any) -> bool:
    """Whether it is an object of python-control or of scipy.signal's linear systems."""
    return type(system).__module__.partition(".")[0] == "control" or hasattr(system, "to_ss")


def as_state_space(system: Any, place: str) -> control.StateSpace:
    """The state space of a system of python-control or scipy.

    Args:
        system: continuous or discrete.
        place: what messages name.
    Raises: ConfigError if it is no linear system with finite coefficients, has more zeros than poles, or is
        discrete without a sampling time.
    """
    import control

    if not is_linear(system) or isinstance(system, control.FrequencyResponseData):
        raise ConfigError([Problem(place, f"it is a {type(system).__name__}", _KINDS)])
    try:
        if type(system).__module__.partition(".")[0] == "control":
            space = control.ss(system)
        else:
            of_scipy = system.to_ss()
            space = control.ss(of_scipy.A, of_scipy.B, of_scipy.C, of_scipy.D, of_scipy.dt or 0)
    except (ValueError, TypeError, NotImplementedError) as error:
        raise ConfigError([Problem(place, f"it has no state space: {error}", _KINDS)]) from error
    if not all(np.isfinite(one).all() for one in (space.A, space.B, space.C, space.D)):
        raise ConfigError([Problem(place, "a coefficient is not finite", "finite numbers")])
    if space.dt is True:
        remedy = "Give it its sampling time, as dt=0.01."
        raise ConfigError([Problem(place, "it is discrete, and its sampling time is not known", "", remedy)])
    return space


def port_names(space: control.StateSpace, place: str) -> tuple[list[str], list[str], list[str]]:
    """States, inputs and outputs: its own labels, or x1, u, y and u1, y1 of several.

    Raises: ConfigError with all labels that are no names.
    """
    found = []
    for labels, letter in ((space.state_labels, "x"), (space.input_labels, "u"), (space.output_labels, "y")):
        if all(_DEFAULT_LABEL.fullmatch(one) for one in labels):
            alone = len(labels) == 1 and letter != "x"
            labels = [letter if alone else f"{letter}{index + 1}" for index in range(len(labels))]
        found.append(list(labels))
    every = [one for names in found for one in names]
    problems = [
        Problem(place, f"the label {one!r} is no name of a variable", "letters, digits and _; each once")
        for one in dict.fromkeys(every)
        if not _NAME.fullmatch(one) or every.count(one) > 1
    ]
    if problems:
        raise ConfigError(problems)
    return found[0], found[1], found[2]


def linear_text(system: Any, name: str) -> str:
    """The Modelica model of a linear system. Coefficients are parameters, but zeros, which stay zeros."""
    space = as_state_space(system, name)
    states, inputs, outputs = port_names(space, name)
    parameters, taken = [], {*states, *inputs, *outputs}

    def sums(letter: str, matrix: NDArray[np.float64], factors: Sequence[str]) -> list[list[str]]:
        rows: list[list[str]] = [[] for _ in matrix]
        for row, column in np.argwhere(matrix):
            known = f"{letter}_{row + 1}_{column + 1}"
            known = f"{known}_" if known in taken else known
            what = f"{letter.upper()}[{row + 1},{column + 1}] of the linear system"
            parameters.append(f'  parameter Real {known} = {float(matrix[row, column])!r} "{what}";')
            rows[row].append(f"{known}*{factors[column]}")
        return rows

    discrete = bool(space.isdtime(strict=True))
    old = [f"pre({one})" for one in states] if discrete else states
    rates = zip(sums("a", space.A, old), sums("b", space.B, inputs), strict=True)
    values = zip(sums("c", space.C, old), sums("d", space.D, inputs), strict=True)
    left = states if discrete else [f"der({one})" for one in states]
    equations = [
        f"  {what} = {' + '.join([*own, *fed]) or '0'};"
        for what, (own, fed) in [*zip(outputs, values, strict=True), *zip(left, rates, strict=True)]
    ]
    held = "discrete " if discrete else ""
    shown = [f'  {held}Real {one}(start=0, fixed=true) "state";' for one in states]
    shown += [f'  input Real {one} "input";' for one in inputs]
    begin = "(start=0, fixed=true)" if discrete else ""
    shown += [f'  {held}output Real {one}{begin} "output";' for one in outputs]
    body = ["equation", *equations]
    if discrete:
        stepped = [line.replace(" = ", " := ", 1) for line in equations]
        body = ["algorithm", f"  when sample(0, {float(space.dt)!r}) then", *stepped, "  end when;"]
    return "\n".join([f'model {name} "Linear system"', *parameters, *shown, *body, f"end {name};", ""])


def build_linear(system: Any, output: Path, name: str, **options: Any) -> BuildReport:
    """Build the FMU of a linear system.

    Args:
        system: of python-control or scipy; a discrete one samples its inputs and holds its outputs.
        output: the FMU.
        name: of the model.
        options: fmi_version, platforms, as for `build`.
    Raises: ConfigError, BuildError.
    """
    from .build import build

    text = linear_text(system, name)
    file = scratch_folder("linear-") / f"{name}.mo"
    file.write_text(text, encoding="utf-8")
    return build(file, output, model=name, **options)


def kept_fmu(system: Any) -> tuple[Path, dict[str, list[str]]]:
    """The FMU of a linear system in this user's cache, built unless it stands there, and its feedthrough.

    Returns: its path; and of a discrete one, whose FMU does not say so, the inputs that act on each output at
        once.
    """
    from .package import this_platform

    space = as_state_space(system, "linear system")
    _, inputs, outputs = port_names(space, "linear system")
    text = linear_text(space, "LinearSystem")
    path = cache_folder("linear") / digest_of(f"{this_platform()}\n{text}".encode())[:16] / "LinearSystem.fmu"
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        build_linear(space, path, "LinearSystem", platforms=(this_platform(),))
    with suppress(OSError):
        os.utime(path.parent)
    keep_last_used(path.parents[1], _MOST_KEPT)
    if not space.isdtime(strict=True):
        return path, {}
    rows = zip(outputs, space.D, strict=True)
    return path, {one: [name for name, gain in zip(inputs, row, strict=True) if gain] for one, row in rows}
