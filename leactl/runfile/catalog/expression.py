"""What is asked of runs in one expression: `condition == 'loaded' and experiment == 'friction' and hold_s >= 6`.

The grammar is a part of Python's and is read by Python's own parser, but Python evaluates nothing of it: each node that
is known here becomes a test of a run, and any other is refused. A run without a value fits no comparison with it.
"""

import ast
import operator
import re
import warnings
from collections.abc import Callable, Collection
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from difflib import get_close_matches
from fnmatch import translate
from typing import Any, Final, get_type_hints

from leactl.errors import InputError
from leactl.runfile.summary import Summary

LONGEST: Final = 2000  # characters, which bounds how deeply it is nested, too
LONGEST_TOLD: Final = 80  # characters of it in a message
MOST_NAMED: Final = 30  # names of parameters in a message
TEXT, NUMBER, MOMENT, TEXTS = "a text", "a number", "a date", "a list of texts"
# what a name stands for; whatever else a run has is a parameter of its protocol
KINDS: Final = {
    name: {str: TEXT}.get(hint, NUMBER)
    for name, hint in get_type_hints(Summary).items()
    if name not in ("folder", "fault", "parameters")
} | {"created": MOMENT, "tags": TEXTS}
RELATIONS: Final[dict[type[ast.cmpop], Callable[[Any, Any], bool]]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
TURNED: Final = {ast.Lt: ast.Gt, ast.LtE: ast.GtE, ast.Gt: ast.Lt, ast.GtE: ast.LtE}
ALLOWED: Final = "comparisons of names with values, and, or, not, in, is None and like(NAME, 'PATTERN')"

Test = Callable[[Summary], bool]
Value = Callable[[Summary], Any]


@dataclass(frozen=True)
class NamedValue:
    """A name in an expression: what it stands for, and how a run's value is had; None where the run has none."""

    text: str
    kind: str  # empty for a parameter, which may be anything
    of: Value


def test_of(text: str, parameters: Collection[str]) -> Test:
    """Read an expression as a test of runs.

    Parameters
    ----------
    parameters : names of the parameters that runs have.

    Raises
    ------
    InputError : it cannot be read, or has a name that no run has; in one line.
    """
    return _Reader(text, parameters).read()


def span_of(text: str) -> tuple[datetime, datetime]:
    """The first moment that a day or a moment stands for, and the first after it; without a zone it is of UTC.

    Raises
    ------
    ValueError : it is neither.
    """
    try:
        if len(text) == len("2026-01-31"):
            day = date.fromisoformat(text)
            first = datetime(day.year, day.month, day.day, tzinfo=UTC)
            return first, first + timedelta(days=1)
        moment = _utc(datetime.fromisoformat(text))
    except OverflowError:
        raise ValueError(text) from None
    return moment, moment


def moment_of(created: str) -> datetime | None:
    """When a run was made; None where its file does not say so in ISO 8601."""
    try:
        return _utc(datetime.fromisoformat(created))
    except (ValueError, OverflowError):
        return None


def _utc(moment: datetime) -> datetime:
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)


class _Reader:
    """The nodes of one expression as tests."""

    def __init__(self, text: str, parameters: Collection[str]) -> None:
        self._text, self._parameters = text, parameters

    def read(self) -> Test:
        if len(self._text) > LONGEST:
            raise InputError(f"--where: {len(self._text)} characters; at most {LONGEST} were expected")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # what Python thinks of '\d'
                tree = ast.parse(self._text.strip(), mode="eval")
            return self._test(tree.body)
        except SyntaxError as fault:
            equals = "; two values are compared by ==" if re.search(r"[^=!<>]=[^=]", self._text) else ""
            raise self._fault(f"is no expression: {fault.msg}{equals}") from None
        except ValueError as fault:  # a NUL, or a number of thousands of digits
            raise self._fault(f"is no expression: {fault}") from None

    def _test(self, node: ast.expr) -> Test:
        match node:
            case ast.BoolOp(ast.And(), values):
                tests = [self._test(value) for value in values]
                return lambda run: all(test(run) for test in tests)
            case ast.BoolOp(ast.Or(), values):
                tests = [self._test(value) for value in values]
                return lambda run: any(test(run) for test in tests)
            case ast.UnaryOp(ast.Not(), operand):
                test = self._test(operand)
                return lambda run: not test(run)
            case ast.Compare(left, operators, rights):
                sides = [left, *rights]
                tests = [self._comparison(*part) for part in zip(sides, operators, rights, strict=False)]
                return tests[0] if len(tests) == 1 else lambda run: all(test(run) for test in tests)
            case ast.Call(ast.Name("like"), [name, ast.Constant(str(pattern))], []):
                return self._like(self._operand(name), pattern, node)
        raise self._fault(f"{self._source(node)} stands where one of {ALLOWED} was expected")

    def _comparison(self, left: ast.expr, relation: ast.cmpop, right: ast.expr) -> Test:
        one, other = self._operand(left), self._operand(right)
        if not isinstance(one, NamedValue) and not isinstance(other, NamedValue):
            raise self._fault(f"{self._source(left)} and {self._source(right)} are compared, and neither is a name")
        match relation:
            case ast.Is() | ast.IsNot():
                return self._missing(one, other, isinstance(relation, ast.Is), right)
            case ast.In() | ast.NotIn():
                test = self._membership(one, other, right)
                if isinstance(relation, ast.In):
                    return test
                value = one.of if isinstance(one, NamedValue) else other.of
                return lambda run: value(run) is not None and not test(run)
        if not isinstance(one, NamedValue):
            assert isinstance(other, NamedValue)
            return self._relation(other, TURNED.get(type(relation), type(relation)), one, left)
        return self._relation(one, type(relation), other, right)

    def _relation(self, name: NamedValue, relation: type[ast.cmpop], other: Any, node: ast.expr) -> Test:
        """Compare a run's value with another of its values, or with one that stands in the expression."""
        compare, value = RELATIONS[relation], name.of
        if isinstance(other, NamedValue):
            second = other.of
            return lambda run: _holds(compare, value(run), second(run))
        if name.kind == MOMENT:
            return self._in_time(name, relation, other, node)
        self._refuse_kind(name, other, node)
        return lambda run: _holds(compare, value(run), other)

    def _in_time(self, name: NamedValue, relation: type[ast.cmpop], other: Any, node: ast.expr) -> Test:
        """Compare a moment with a day, which is whole, or with another moment."""
        try:
            first, after = span_of(other)
        except (ValueError, TypeError):
            expected = f"{name.text} is {MOMENT}, such as '2026-01-31' or '2026-01-31T13:00'"
            raise self._fault(f"{expected}; {self._source(node)} is none") from None
        value = name.of
        inside: Callable[[datetime], bool] = lambda moment: moment == first or first <= moment < after  # noqa: E731
        tests: dict[type[ast.cmpop], Callable[[datetime], bool]] = {
            ast.Eq: inside,
            ast.NotEq: lambda moment: not inside(moment),
            ast.Lt: lambda moment: moment < first,
            ast.LtE: lambda moment: moment < first or inside(moment),
            ast.Gt: lambda moment: moment > first and not inside(moment),
            ast.GtE: lambda moment: moment >= first,
        }
        test = tests[relation]
        return lambda run: (moment := value(run)) is not None and test(moment)

    def _membership(self, one: Any, other: Any, node: ast.expr) -> Test:
        """Whether a value is one of a list, or a text is part of a text or a member of a list."""
        if isinstance(other, list) and isinstance(one, NamedValue):
            tests = [self._relation(one, ast.Eq, item, node) for item in other]
            return lambda run: any(test(run) for test in tests)
        if isinstance(other, NamedValue) and not isinstance(one, NamedValue):
            if other.kind in (NUMBER, MOMENT):
                raise self._fault(f"{other.text} is {other.kind} and holds no others; it is compared by == or <")
            value = other.of
            return lambda run: _is_part(one, value(run))
        raise self._fault(
            f"{self._source(node)} follows in; a list such as ('a', 'b'), or the name of a text or a list was expected"
        )

    def _missing(self, one: Any, other: Any, wanted: bool, node: ast.expr) -> Test:
        if not isinstance(one, NamedValue) or other is not None:
            raise self._fault(f"{self._source(node)} follows is; None was expected, and == elsewhere")
        value = one.of
        return lambda run: (value(run) is None) == wanted

    def _like(self, name: Any, pattern: str, node: ast.expr) -> Test:
        if not isinstance(name, NamedValue) or name.kind in (NUMBER, MOMENT):
            raise self._fault(f"{self._source(node)}: the name of a text or of a list was expected first")
        fits, value = re.compile(translate(pattern)).match, name.of

        def test(run: Summary) -> bool:
            found = value(run)
            texts = found if isinstance(found, list | tuple) else [found]
            return any(isinstance(text, str) and fits(text) is not None for text in texts)

        return test

    def _operand(self, node: ast.expr) -> Any:
        """A name, or a value: text, number, None, or a list of those."""
        match node:
            case ast.Name(name):
                return self._name(name, node)
            case ast.Attribute(ast.Name("parameters"), name) | ast.Subscript(
                ast.Name("parameters"), ast.Constant(str(name))
            ):
                if name not in self._parameters:
                    raise self._fault(f"no run has a parameter {name!r}{self._hint(name, self._parameters)}")
                return _parameter(name)
            case ast.Constant(value) if value is None or isinstance(value, str | int | float):
                return value
            case ast.UnaryOp(ast.USub(), ast.Constant(int(value) | float(value))):
                return -value
            case ast.List(items) | ast.Tuple(items):
                values = [self._operand(item) for item in items]
                if not any(isinstance(value, NamedValue | list) for value in values):
                    return values
        raise self._fault(f"{self._source(node)} stands where a name, a text, a number or a list of those was expected")

    def _name(self, name: str, node: ast.expr) -> NamedValue:
        if name == "created":
            return NamedValue(name, MOMENT, lambda run: moment_of(run.created))
        if name == "tags":
            return NamedValue(name, TEXTS, lambda run: list(run.tags))
        if name in KINDS:
            return NamedValue(name, KINDS[name], operator.attrgetter(name))
        if name in self._parameters:
            return _parameter(name)
        raise self._fault(
            f"no run has {name!r}{self._hint(name, [*KINDS, *self._parameters])}; a text stands in quotes"
        )

    def _hint(self, name: str, known: Collection[str]) -> str:
        if close := get_close_matches(name, known, n=1):
            return f"; did you mean {close[0]!r}"
        there = sorted(known)
        more = f" and {len(there) - MOST_NAMED} more" if len(there) > MOST_NAMED else ""
        return f"; known: {', '.join(there[:MOST_NAMED]) or 'none'}{more}; a text stands in quotes"

    def _refuse_kind(self, name: NamedValue, other: Any, node: ast.expr) -> None:
        expected = {TEXT: str, NUMBER: (int, float), TEXTS: list}.get(name.kind, object)
        if other is None:
            raise self._fault(f"{name.text} is compared with None; is None was expected")
        if not isinstance(other, expected):  # type: ignore[arg-type]
            member = f"; {self._source(node)} in {name.text} asks for a member" if name.kind == TEXTS else ""
            raise self._fault(f"{name.text} is {name.kind}; {self._source(node)} is none{member}")

    def _source(self, node: ast.expr) -> str:
        return _cut(ast.get_source_segment(self._text.strip(), node) or "it")

    def _fault(self, why: str) -> InputError:
        return InputError(f"--where {_cut(self._text)}: {why}")


def _cut(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= LONGEST_TOLD else f"{line[:LONGEST_TOLD]} ..."


def _parameter(name: str) -> NamedValue:
    return NamedValue(name, "", lambda run: run.parameters.get(name))


def _holds(compare: Callable[[Any, Any], bool], value: Any, other: Any) -> bool:
    """Whether two values compare so; a text, a number and a list are unequal, and none is the greater."""
    if value is None or other is None:
        return False
    numbers = isinstance(value, int | float), isinstance(other, int | float)
    if all(numbers) or (
        type(value) is type(other) and (isinstance(value, str) or compare in (operator.eq, operator.ne))
    ):
        return bool(compare(value, other))
    return compare is operator.ne


def _is_part(value: Any, whole: Any) -> bool:
    if isinstance(whole, str):
        return isinstance(value, str) and value in whole
    return isinstance(whole, list | tuple) and value in whole
