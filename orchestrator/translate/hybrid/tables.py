"""Tables of the Modelica Standard Library: piecewise polynomials that the FMU holds.

The rules are those of CombiTable1D, CombiTable2D and CombiTimeTable in version 4.1.0 of that library.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from orchestrator.base.errors import BuildError

from . import expression as ex
from .expression import Expr

LINEAR, AKIMA, CONSTANT, FRITSCH_BUTLAND, STEFFEN, MODIFIED_AKIMA = range(1, 7)
HOLD, LAST_TWO_POINTS, PERIODIC, NONE = range(1, 5)
ALWAYS, AT_DISCONTINUITIES, _NO_EVENTS = range(1, 4)
_NEVER = 1.7976931348623157e308
_numbers = itertools.count()


@dataclass
class Table:
    """A table that expressions refer to by its number.

    Attributes:
        rows: the matrix.
        columns: of each output, counted from 1.
        smoothness, extrapolation, events: as the library numbers them.
        start, shift: of time tables, in units of the first column.
        surface_of: whether it has two variables: its first row holds the second.
    """

    rows: np.ndarray
    columns: Sequence[int]
    smoothness: int
    extrapolation: int
    events: int = _NO_EVENTS
    start: float = -math.inf
    shift: float = 0.0
    surface_of: bool = False

    def __post_init__(self) -> None:
        self.number = next(_numbers)
        _KNOWN[self.number] = self
        first = self.rows[int(self.surface_of) :, 0]
        least = 0 if self.events != _NO_EVENTS or self.start > -math.inf else np.finfo(float).tiny
        if len(first) > 1 and not (np.diff(first) >= least).all():
            raise BuildError("the first column of a table has to increase")

    def value(self, column: Expr, u: Expr, limit: Expr | None = None) -> Expr:
        """The output of a column; up to `limit` the piece before it counts."""
        return ex.make(f"table:{self.number}:{_whole(column)}:0", u, limit or ex.number(_NEVER))

    def at_time(self, column: Expr, time: Expr, next_event: Expr) -> Expr:
        """The output of a time table between events."""
        u = ex.sub(time, ex.number(self.shift))
        value = self.value(column, u, ex.sub(next_event, ex.number(self.shift)))
        begun = ex.logical("gt", next_event, ex.number(self.start))
        return ex.conditional(begun, value, ex.ZERO)

    def next_event(self, time: Expr) -> Expr:
        """When the next event after a time is."""
        return ex.make(f"event:{self.number}", time)

    def surface(self, a: Expr, b: Expr) -> Expr:
        """The value of a table of two variables."""
        if self.smoothness not in (LINEAR, CONSTANT):
            raise BuildError(
                "smooth interpolation of a CombiTable2D is not supported; choose "
                "Smoothness.LinearSegments or ConstantSegments"
            )
        return ex.make(f"surface:{self.number}:0:0", a, b)

    def instants(self) -> list[float]:
        """Where events are, in the first column."""
        first = self.rows[:, 0]
        if self.events == ALWAYS or self.smoothness == CONSTANT:
            return sorted(set(first))
        twice = {float(a) for a, b in itertools.pairwise(first) if a == b}
        if self.extrapolation == PERIODIC:
            twice |= {float(first[0]), float(first[-1])}
        return sorted(twice) if self.events == AT_DISCONTINUITIES or self.extrapolation == PERIODIC else []

    def pieces(self, column: int) -> list[tuple[float, float, tuple[float, ...]]]:
        """Begin, reference point and coefficients, lowest order first, of each piece."""
        x, y = self.rows[:, 0], self.rows[:, self.columns[column - 1] - 1]
        if len(x) == 1:
            return [(-math.inf, 0.0, (float(y[0]), 0.0, 0.0, 0.0))]
        kind = LINEAR if len(x) == 2 and self.smoothness != CONSTANT else self.smoothness
        steps, inner = np.diff(x), np.diff(x) > 0
        rise = np.divide(np.diff(y), steps, out=np.zeros(len(steps)), where=inner)
        found = []
        if kind in (LINEAR, CONSTANT):
            for k in np.flatnonzero(inner):
                slope = rise[k] if kind == LINEAR else 0.0
                found.append((x[k], x[k], (y[k], slope, 0.0, 0.0)))
            ends = [rise[np.flatnonzero(inner)[0]], rise[np.flatnonzero(inner)[-1]]]
        else:
            slopes = _SLOPES[kind](x, rise)
            for k in range(len(rise)):
                a, b, width = slopes[k], slopes[k + 1], steps[k]
                cubic = (a + b - 2 * rise[k]) / width**2
                found.append((x[k], x[k], (y[k], a, (3 * rise[k] - 2 * a - b) / width, cubic)))
            ends = [slopes[0], slopes[-1]]
        outer = {HOLD: (0.0, 0.0), LAST_TWO_POINTS: tuple(ends)}.get(self.extrapolation)
        if self.extrapolation == PERIODIC:
            return found
        lost = math.nan
        left = (y[0], outer[0], 0.0, 0.0) if outer else (lost,) * 4
        right = (y[-1], outer[1], 0.0, 0.0) if outer else (lost,) * 4
        begin = x[-1] if outer else float(np.nextafter(x[-1], math.inf))
        return [(-math.inf, x[0], left), *found, (begin, x[-1], right)]


_KNOWN: dict[int, Table] = {}


def _whole(one: Expr) -> int:
    if one.op != "num":
        raise BuildError("a column of a table that is not known when the model is built is not supported")
    return int(one.args[0])


def _weighted(x: np.ndarray, d: np.ndarray, modified: bool) -> np.ndarray:
    """Slopes by Akima (Journal of the ACM 17, 1970), or with the weights of MATLAB's makima."""
    d = np.concatenate(
        [[3 * d[0] - 2 * d[1], 2 * d[0] - d[1]], d, [2 * d[-1] - d[-2], 3 * d[-1] - 2 * d[-2]]]
    )
    found = []
    for k in range(len(x)):
        a, b, c, e = d[k : k + 4]
        right, left = abs(e - c), abs(b - a)
        if modified:
            right, left = right + abs(e + c) / 2, left + abs(b + a) / 2
        total = right + left
        share = left / total if total > 0 else 0.5
        found.append(0.0 if modified and total == 0 else (1 - share) * b + share * c)
    return np.array(found)


def _monotone(x: np.ndarray, d: np.ndarray, steffen: bool) -> np.ndarray:
    found = [d[0]]
    for k, (a, b) in enumerate(itertools.pairwise(d)):
        h, g = x[k + 1] - x[k], x[k + 2] - x[k + 1]
        if a * b <= 0:
            found.append(0.0)
        elif steffen:
            slope = (a * g + b * h) / (h + g)
            least = min(abs(a), abs(b))
            found.append(math.copysign(2 * least, a) if abs(slope) > 2 * least else slope)
        else:
            found.append(3 * (h + g) / ((h + 2 * g) / a + (g + 2 * h) / b))
    return np.array([*found, d[-1]])


_SLOPES: dict[int, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    AKIMA: lambda x, d: _weighted(x, d, False),
    MODIFIED_AKIMA: lambda x, d: _weighted(x, d, True),
    FRITSCH_BUTLAND: lambda x, d: _monotone(x, d, False),
    STEFFEN: lambda x, d: _monotone(x, d, True),
}


# Code


def _derived(one: Expr, d: Sequence[Expr]) -> Expr:
    kind, *numbers = one.op.split(":")
    if kind == "event":
        return ex.ZERO
    if kind == "table":
        number, column, order = map(int, numbers)
        return ex.mul(ex.make(f"table:{number}:{column}:{order + 1}", *one.args), d[0])
    number, first, second = map(int, numbers)
    a = ex.make(f"surface:{number}:{first + 1}:{second}", *one.args)
    b = ex.make(f"surface:{number}:{first}:{second + 1}", *one.args)
    return ex.add(ex.mul(a, d[0]), ex.mul(b, d[1]))


def _called(one: Expr, args: Sequence[str]) -> str:
    kind, number, *more = one.op.split(":")
    orders = [more[-1]] if kind == "table" else more
    name = f"table_{number}_{more[0]}" if kind == "table" else f"{kind}_{number}"
    return f"{name}({', '.join([*orders, *args])})"


for _kind in ("table", "event", "surface"):
    ex.OTHERS[_kind] = ex.Other(_derived, _called)


def table_code(used: Iterable[Expr]) -> list[str]:
    """C of the tables in expressions."""
    wanted = sorted({tuple(one.op.split(":")[:3]) for one in used if one.op.split(":")[0] in ex.OTHERS})
    lines = []
    for kind, number, *column in {(kind, *rest[: 1 + (kind == "table")]): 0 for kind, *rest in wanted}:
        if kind not in ("table", "event", "surface"):
            continue
        table = _KNOWN[int(number)]
        first = table.rows[:, 0]
        period = float(first[-1] - first[0]) if table.extrapolation == PERIODIC and len(first) > 1 else 0.0
        name = f"table_{number}_{column[0]}" if column else f"{kind}_{number}"
        if kind == "table":
            pieces = table.pieces(int(column[0]))
            numbers = ", ".join(_c(n) for begin, at, c in pieces for n in (begin, at, *c))
            lines.append(f"""static double {name}(int order, double u, double limit)
{{
    static const double pieces[] = {{{numbers}}};
    return piecewise(pieces, {len(pieces)}, {_c(first[0])}, {_c(period)}, order, u, limit);
}}
""")
        elif kind == "event":
            instants = table.instants()
            numbers = ", ".join(map(_c, instants)) or "0"
            lines.append(f"""static double {name}(double t)
{{
    static const double at[] = {{{numbers}}};
    return next_instant(at, {len(instants)}, {_c(period)}, {_c(table.start)}, {_c(table.shift)}, t);
}}
""")
        else:
            cells = ", ".join(_c(n) for n in table.rows.ravel())
            rows, columns = table.rows.shape
            how = f"{int(table.smoothness == CONSTANT)}, {table.extrapolation}"
            lines.append(f"""static double {name}(int by_a, int by_b, double a, double b)
{{
    static const double cells[] = {{{cells}}};
    return interpolated(cells, {rows}, {columns}, {how}, by_a, by_b, a, b);
}}
""")
    return [TABLE_C, *lines] if lines else []


def _c(value: float) -> str:
    text = repr(float(value))
    return {"inf": "INFINITY", "-inf": "-INFINITY", "nan": "NAN"}.get(text, text)


TABLE_C = """/* Pieces of begin, reference point and four coefficients; periodic where `period` is not 0. */
static inline double piecewise(const double *p, int n, double low, double period, int order, double u,
                               double limit)
{
    /* Where the piece is looked up: up to an event, that before it. */
    double at = u >= limit ? limit - 1e-9 * (fabs(limit) > 1e-3 ? fabs(limit) : 1e-3) : u;
    double turns = period > 0 ? floor((at - low) / period) * period : 0, v;
    int first = 0, last = n - 1;
    at -= turns;
    while (first < last) {
        int middle = (first + last + 1) / 2;
        if (at >= p[6 * middle])
            first = middle;
        else
            last = middle - 1;
    }
    p += 6 * first;
    v = u - turns - p[1];
    if (order == 0) return p[2] + v * (p[3] + v * (p[4] + v * p[5]));
    if (order == 1) return p[3] + v * (2 * p[4] + v * 3 * p[5]);
    if (order == 2) return 2 * p[4] + 6 * p[5] * v;
    return order == 3 ? 6 * p[5] : 0;
}

static inline double next_instant(const double *at, int n, double period, double start, double shift,
                                  double t)
{
    double close = t + 1e-12 * (fabs(t) > 1 ? fabs(t) : 1), turns;
    if (close < start) return start;
    if (n == 0) return 1.7976931348623157e308;
    turns = period > 0 ? floor((close - shift - at[0]) / period) * period : 0;
    for (int k = 0; k < n; k++)
        if (at[k] + shift + turns > close) return at[k] + shift + turns;
    return 1.7976931348623157e308;
}

/* How often a variable beyond the ends is moved, and the interval: of n points that are `stride` apart. */
static inline int interval(const double *x, int n, int stride, int extrapolation, int *outside, double *u)
{
    double low = x[0], high = x[(n - 1) * stride];
    int k = 0;
    *outside = *u < low || *u > high;
    if (extrapolation == 3 && high > low) *u -= floor((*u - low) / (high - low)) * (high - low);
    if (extrapolation == 1) *u = *u < low ? low : *u > high ? high : *u;
    while (k < n - 2 && *u >= x[(k + 1) * stride]) k++;
    return k;
}

static inline double interpolated(const double *cells, int rows, int columns, int constant, int extrapolation,
                                  int by_a, int by_b, double a, double b)
{
    int beyond[2], n = rows - 1, m = columns - 1;
    int i = interval(cells + columns, n, columns, extrapolation, &beyond[0], &a);
    int j = interval(cells + 1, m, 1, extrapolation, &beyond[1], &b);
    const double *z = cells + (i + 1) * columns + j + 1;
    double width = 1, height = 1, share = 0, part = 0, da, db;
    if (extrapolation == 4 && (beyond[0] || beyond[1])) return NAN;
    if (n > 1) {
        width = cells[(i + 2) * columns] - cells[(i + 1) * columns];
        share = (a - cells[(i + 1) * columns]) / width;
    }
    if (m > 1) {
        height = cells[j + 2] - cells[j + 1];
        part = (b - cells[j + 1]) / height;
    }
    if (constant && !(extrapolation == 2 && (beyond[0] || beyond[1]))) {
        if (by_a || by_b) return 0;
        return z[(share >= 1 ? columns : 0) + (part >= 1 ? 1 : 0)];
    }
    if (extrapolation == 1 && ((by_a && beyond[0]) || (by_b && beyond[1]))) return 0;
    if (by_a > 1 || by_b > 1) return 0;
    if ((by_a && n < 2) || (by_b && m < 2)) return 0;
    da = n > 1 ? z[columns] - z[0] : 0;
    db = m > 1 ? z[1] - z[0] : 0;
    if (n > 1 && m > 1) {
        double twist = z[columns + 1] - z[columns] - z[1] + z[0];
        if (by_a && by_b) return twist / (width * height);
        if (by_a) return (da + twist * part) / width;
        if (by_b) return (db + twist * share) / height;
        return z[0] + da * share + db * part + twist * share * part;
    }
    if (by_a && by_b) return 0;
    if (by_a) return da / width;
    if (by_b) return db / height;
    return z[0] + da * share + db * part;
}
"""


# Files


def read_table(path: Path, name: str) -> np.ndarray:
    """The matrix of a file: text, CSV or MATLAB's.

    Raises: BuildError if there is none of that name.
    """
    if not path.is_file():
        raise BuildError(
            f"the table file {path} does not exist; give a path beside the model, or an absolute one"
        )
    if path.suffix.lower() == ".mat":
        from scipy.io import loadmat

        found = loadmat(path, variable_names=[name]).get(name)
        if found is None:
            raise BuildError(f"{path}: no matrix {name}")
        return np.atleast_2d(np.asarray(found, dtype=float))
    text = path.read_text()
    if path.suffix.lower() == ".csv":
        rows = [line.split(",") for line in text.splitlines() if line.strip()]
        return np.array([[float(cell) for cell in row] for row in rows if _numeric(row)])
    lines = iter(re.sub(r"#(?!1\b).*", "", text).splitlines())
    for line in lines:
        head = re.match(r"\s*(?:double|float)\s+(\S+)\s*\(\s*(\d+)\s*,\s*(\d+)\s*\)", line)
        if not head or head[1] != name:
            continue
        count = int(head[2]) * int(head[3])
        numbers: list[float] = []
        for row in lines:
            numbers += [float(cell) for cell in re.split(r"[\s,;]+", row.strip()) if cell]
            if len(numbers) >= count:
                return np.array(numbers[:count]).reshape(int(head[2]), int(head[3]))
    raise BuildError(f"{path}: no table {name}")


def _numeric(row: Sequence[str]) -> bool:
    try:
        [float(cell) for cell in row]
    except ValueError:
        return False
    return True
