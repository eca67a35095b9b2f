"""Operators and constructors of records in the expressions of a class, as calls of their functions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from orchestrator.base.errors import BuildError, listed

from ..lexer import Token
from ..sources import location
from .declared_classes import DeclaredClass
from .operator_values import MAKER, Value, built_in_operator, fits, getter, over_elements
from .typed_classes import TypedClasses


@dataclass
class OperatorCalls:
    """Calls that stand for operators of one class.

    Attributes:
        known: all classes. strict: whether to refuse what has no meaning.
        loops: iterators around. at: the token that is read next.
        rewritten: whether something differs from the source. event: whether it is in a when-equation.
    """

    known: TypedClasses
    one: DeclaredClass
    strict: bool
    loops: list[str] = field(default_factory=list)
    at: int = 0
    rewritten: bool = False
    event: bool = False

    @property
    def _tokens(self) -> Sequence[Token]:
        return self.one.tokens

    def _word(self) -> str:
        return self._tokens[self.at].text

    def _record(self, kind: str) -> DeclaredClass:
        found = self.known._get(kind[1:])
        assert found is not None
        return found

    def _member(self, one: Value, name: str) -> str:
        if one.members is not None:
            return one.members(name)
        return f"{self._path(one.kind)}.{getter(name)}({one.text})"

    def _path(self, name: str) -> str:
        self.rewritten = True
        return self.known._named(name, self.one)

    def _element(self, one: Value) -> Value:
        if not one.sizes:
            return one
        members = one.members if one.called else lambda name: f"{one.element}.{name}"
        return replace(one, text=one.element, sizes=one.sizes[1:], element="", members=members)

    def _error(self, at: int, what: str, remedy: str) -> BuildError:
        one = self.one
        place = location(self.known._label + one.file, one.text, one.tokens[at].start)
        return BuildError(f"{place}: {what} is not supported; {remedy}")

    def _chosen(self, kind: str, values: Sequence[Value], written: Callable[[Sequence[str]], str]) -> Value:
        """One of several records, member by member: the compiler takes no others as arguments."""

        def members(name: str) -> str:
            return written([self._member(one, name) for one in values])

        texts = [members(name) for name in self.known.components(self._record(kind))]
        # The compiler asks for a record among the arguments.
        text = f"{self._path(kind)}.{MAKER}({', '.join([values[0].text, *texts])})"
        return Value(text, kind, members=members)

    def _applied(self, at: int, sign: str, given: list[Value]) -> Value:
        """An operator of built-in operands, or the call of its function."""
        if not any(one.is_record for one in given):
            return built_in_operator(sign, given)
        name = sign.removeprefix(".") or sign
        if sign.strip(".") == "+" and len(given) == 1:
            return given[0]
        if unknown := next((one for one in given if not one.kind), None):
            raise self._error(
                at, f"`{sign}` with `{unknown.text}`, whose type is not found,",
                "declare a variable of the type that it has, and use that",
            )  # fmt: skip
        records = dict.fromkeys(one.kind for one in given if one.is_record)
        functions = [one for record in records for one in self.known.operators(record, name)]
        exact = [one for one in functions if self._matches(one, given)]
        if not exact and any(one.sizes for one in given):
            return self._each(at, sign, given)
        if len(exact) == 1:
            return self._call(exact[0], given)
        fitting = functions if not exact else []
        converted = [(one, more) for one in fitting if (more := self._converted(one, given))]
        if len(converted) == 1:
            return self._call(*converted[0])
        several = "several operators" if exact or converted else "no operator"
        raise self._error(
            at, f"`{sign}` of {' and '.join(one.kind.strip('.') for one in given)}, for which {several} of "
            f"{listed([record[1:] for record in records])} could stand,",
            f"declare an operator '{name}' for it, or call a function",
        )  # fmt: skip

    def _each(self, at: int, sign: str, given: list[Value]) -> Value:
        """An operator of each element of arrays."""
        sizes = [one.sizes for one in given if one.sizes]
        both = len(given) == 2 and all(one.sizes for one in given)
        scalar = len(given) == 2 and not both
        fits = sign[0] == "." or (sign in "+-" and not scalar)
        fits = fits or (sign in "*/" and not both and not (sign == "/" and given[-1].sizes))
        fits = fits and all(len(one) == 1 for one in sizes)
        if not fits or any(one.sizes and not one.element for one in given):
            raise self._error(at, f"`{sign}` of these arrays", "write it for their elements")
        value = self._applied(at, sign.removeprefix("."), [self._element(one) for one in given])
        return over_elements(value, sizes[0][0])

    def _matches(self, one: DeclaredClass, given: Sequence[Value], names: Sequence[str] = ()) -> bool:
        inputs = self.known.signature(one)[0]
        rest = {other.name: other for other in inputs}
        for place, value in enumerate(given):
            name = names[place] if place < len(names) else ""
            wanted = rest.pop(name or (inputs[place].name if place < len(inputs) else ""), None)
            if wanted is None or len(value.sizes) != wanted.depth or not fits(value.kind, wanted.kind):
                return False
        return all(other.optional for other in rest.values())

    def _converted(self, one: DeclaredClass, given: Sequence[Value]) -> list[Value]:
        """The operands, those that do not fit made by constructors; none where this does not help."""
        inputs, made = self.known.signature(one)[0], []
        if len(inputs) < len(given) or any(not other.optional for other in inputs[len(given) :]):
            return []
        for wanted, value in zip(inputs, given, strict=False):
            if wanted.kind != value.kind and wanted.kind.startswith("."):
                makers = self.known.operators(wanted.kind, "constructor")
                makers = [maker for maker in makers if self._matches(maker, [value])]
                if len(makers) != 1:
                    return []
                value = self._call(makers[0], [value])
            elif not fits(value.kind, wanted.kind):
                return []
            if len(value.sizes) != wanted.depth:
                return []
            made.append(value)
        return made

    def _call(self, one: DeclaredClass, given: Sequence[Value], names: Sequence[str] = ()) -> Value:
        named = [
            f"{names[place]} = {value.text}" if place < len(names) and names[place] else value.text
            for place, value in enumerate(given)
        ]
        kind, sizes = self.known.signature(one)[1]
        record, _, rest = one.name.partition(".'")
        return Value(f"{self._path(f'.{record}')}.'{rest}({', '.join(named)})", kind, sizes)

    def _of_each_member(self, name: str, values: Sequence[Value], text: str) -> Value:
        first = values[-1] if name == "smooth" else values[0]

        def members(member: str) -> str:
            texts = [self._member(one, member) if one.is_record else one.text for one in values]
            return f"{name}({', '.join(texts)})"

        return Value(text, first.kind, first.sizes, "", members if first.is_record else None)

    def _constructed(
        self, begin: int, kind: str, values: Sequence[Value], names: Sequence[str], text: str
    ) -> Value:
        makers = self.known.operators(kind, "constructor")
        if not makers:
            return Value(text, kind)
        fitting = [one for one in makers if self._matches(one, values, names)]
        if len(fitting) == 1:
            return replace(self._call(fitting[0], values, names), kind=kind)
        if any(not one.kind for one in values) and len(makers) == 1 and not any(one.sizes for one in values):
            return replace(self._call(makers[0], values, names), kind=kind)
        raise self._error(
            begin, f"{kind[1:]}() with {len(values)} arguments of these types",
            "give those of one of its constructors",
        )  # fmt: skip
