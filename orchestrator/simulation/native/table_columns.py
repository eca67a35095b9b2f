"""Columns and codes of the tables that define the calls of the native loop."""

from __future__ import annotations

from enum import IntEnum, auto


class _Column(IntEnum):
    @staticmethod
    def _generate_next_value_(name: str, start: int, count: int, last: list[int]) -> int:
        return count


class Call(_Column):
    """Columns of the table of get and set functions; addresses unless set otherwise."""

    FUNCTION = auto()
    COMPONENT = auto()
    REFERENCES = auto()
    COUNT = auto()  # of references
    VALUES = auto()
    CODE = auto()  # type of the values
    PLACE = auto()  # where the list of their places in memory begins
    VALUE_COUNT = auto()


class Step(_Column):
    """Columns of the table of instances; addresses unless set otherwise."""

    VERSION = auto()  # of FMI
    FUNCTION = auto()
    COMPONENT = auto()
    NO_ROLLBACK = auto()  # whether no state is kept
    EVENT = auto()  # where the step's results go; FMI 2 has two of them, and gives them when it is asked
    TERMINATE = auto()
    EARLY = auto()
    REACHED = auto()
    ASK_TERMINATE = auto()  # FMI 2: functions that give them; 0 without one
    ASK_REACHED = auto()
    FIRST_SET = auto()  # rows of the table of calls
    END_SET = auto()
    FIRST_GET = auto()
    END_GET = auto()
    FIRST_INPUT = auto()  # places in the vector of inputs
    END_INPUT = auto()
    CONVERTS = auto()  # whether gains and offsets apply
    EVERY = auto()  # communication steps of one of its own steps
    PARTS = auto()  # its own steps in a communication step


class Path(_Column):
    """Columns of the table of connections with effects."""

    PLACE = auto()  # in the vector of signals
    FIRST_LEG = auto()  # rows of the list of summands
    END_LEG = auto()
    FIRST_LINK = auto()  # rows of the table of effects
    END_LINK = auto()


class Chained(_Column):
    """Columns of the table of effects on connections; addresses unless set otherwise."""

    KIND = auto()  # number of a built-in effect; -1: another, by its function
    FUNCTION = auto()
    X = auto()  # the signals that it is given
    X_COUNT = auto()
    FIRST_READ = auto()  # where the list of the further ones begins
    OPTIONS = auto()
    OPTION_COUNT = auto()
    MEMORY = auto()
    MEMORY_COUNT = auto()


class Ahead(_Column):
    """What a master that extrapolates keeps; addresses unless set otherwise. See `ahead.Curves`."""

    ORDER = auto()  # of the polynomial
    SIZE = auto()  # how many signals there are
    PAST = auto()  # the signals at the latest points, newest first
    MIDDLE = auto()  # and as they are supposed to be in the middle of the step,
    END = auto()  # and at its end
    WEIGHTS = auto()  # by order: of the middle, the end, and the middle once the end is known
    SMOOTH = auto()  # whether a signal runs along a polynomial
    GIVEN = auto()  # by input, see `Given`
    SPANS = auto()  # where the signals of each instance begin, and end
    BENDS = auto()  # table of calls that return derivatives
    BOUNDS = auto()  # where those of each instance begin, and end
    PLACES = auto()  # of the inputs whose derivatives these return


class Given(_Column):
    """What an input is given over a step along a curve."""

    MIDDLE = auto()
    END = auto()
    COURSE = auto()  # value and derivatives at the begin


class Bend(_Column):
    """Columns of the table of functions that take derivatives of inputs; addresses unless set otherwise."""

    FUNCTION = auto()
    COMPONENT = auto()
    REFERENCES = auto()
    COUNT = auto()
    ORDERS = auto()  # of each derivative; two such lists, of first and of second ones
    VALUES = auto()
    FIRST_PLACE = auto()  # row of the list of places


class Plain(_Column):
    """Columns of the plan of a plain system; addresses unless set otherwise."""

    COMPONENT = auto()
    SETTER = auto()
    INPUTS = auto()  # references
    INPUT_COUNT = auto()  # of them
    U = auto()
    STEP = auto()
    NO_ROLLBACK = auto()  # whether no state is kept
    GETTER = auto()
    OUTPUTS = auto()  # references
    OUTPUT_COUNT = auto()  # of them
    Y = auto()
    FIRST_INPUT = auto()  # places in the vector of inputs, of those that are fed right before the step
    END_INPUT = auto()
    POSITION = auto()  # of the instance
    SET_ROW = auto()  # of the table of calls
    GET_ROW = auto()


class Code(_Column):
    """Types of values; DIRECT: doubles that are moved where they lie."""

    DIRECT = auto()
    F64 = auto()
    F32 = auto()
    I8 = auto()
    U8 = auto()
    I16 = auto()
    U16 = auto()
    I32 = auto()
    U32 = auto()
    I64 = auto()
    U64 = auto()
    BOOL = auto()


class Phase(_Column):
    """Where a chunk ended."""

    DONE = auto()
    SET = auto()
    ADVANCE = auto()
    GET = auto()
    FINITE = auto()  # a signal is not finite
    CONVERT = auto()  # an input cannot become a whole number of its type
    BEND = auto()  # derivatives of inputs were refused


class Outcome(_Column):
    """Entries of what a chunk says about its end."""

    WHO = auto()  # position of the instance
    PHASE = auto()
    BLOCK = auto()  # row of the table of calls
    STATUS = auto()
    PART = auto()  # of the instance's own steps in a communication step
    ENDER = auto()  # position of the instance that ends the simulation after the last step; -1: none
