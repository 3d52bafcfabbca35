"""Select runs by an expression: `condition == 'loaded' and experiment == 'friction' and hold_s >= 6`.

The grammar is a subset of Python's and is parsed by Python's own parser, but never evaluated by Python: each known node
becomes a test of a run and any other node is refused. A comparison with a value that a run lacks is false.
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

MOST_CHARACTERS: Final = 2000  # of an expression; bounds its nesting as well
MOST_CHARACTERS_SHOWN: Final = 80  # characters of the expression in a message
MOST_NAMES_SHOWN: Final = 30  # names of parameters in a message
TEXT, NUMBER, MOMENT, TEXTS = "a text", "a number", "a date", "a list of texts"
# kind of the values of each attribute of a run; any other name is that of a protocol parameter
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
MIRRORED: Final = {ast.Lt: ast.Gt, ast.LtE: ast.GtE, ast.Gt: ast.Lt, ast.GtE: ast.LtE}
ALLOWED: Final = "comparisons of names with values, and, or, not, in, is None and like(NAME, 'PATTERN')"

Test = Callable[[Summary], bool]
Value = Callable[[Summary], Any]


@dataclass(frozen=True)
class NamedValue:
    """A name in an expression, with the kind of its values."""

    text: str
    kind: str  # empty for a parameter, which may have values of any kind
    of: Value  # function that returns a run's value, or None if the run has none


def read_expression(text: str, parameters: Collection[str]) -> Test:
    """Parse an expression into a test of runs.

    Parameters
    ----------
    parameters : names of the parameters that runs have.

    Raises
    ------
    InputError : the expression cannot be parsed, or has a name that no run has; in one line.
    """
    return _Parser(text, parameters).parse()


def span_of(text: str) -> tuple[datetime, datetime]:
    """Return start and end of a day, or a moment twice; a text without a zone is taken as UTC.

    Raises
    ------
    ValueError : the text is neither a date nor an ISO 8601 moment.
    """
    try:
        if len(text) == len("2026-01-31"):
            day = date.fromisoformat(text)
            start = datetime(day.year, day.month, day.day, tzinfo=UTC)
            return start, start + timedelta(days=1)
        moment = _utc(datetime.fromisoformat(text))
    except OverflowError:
        raise ValueError(text) from None
    return moment, moment


def moment_of(created: str) -> datetime | None:
    """Return the time of a run's creation (UTC); None if the text is not an ISO 8601 moment."""
    try:
        return _utc(datetime.fromisoformat(created))
    except (ValueError, OverflowError):
        return None


def _utc(moment: datetime) -> datetime:
    """Return a moment in UTC; a moment without a zone is taken as UTC."""
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)


class _Parser:
    """Parser of one expression: turns its nodes into tests of runs."""

    def __init__(self, text: str, parameters: Collection[str]) -> None:
        self._text, self._parameters = text, parameters

    def parse(self) -> Test:
        """Return the test of runs that the expression stands for.

        Raises
        ------
        InputError : as `read_expression`.
        """
        if len(self._text) > MOST_CHARACTERS:
            raise InputError(f"--where: {len(self._text)} characters; at most {MOST_CHARACTERS} were expected")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # such as that '\d' is no escape sequence
                tree = ast.parse(self._text.strip(), mode="eval")
            return self._test(tree.body)
        except SyntaxError as fault:
            hint = "; two values are compared by ==" if re.search(r"[^=!<>]=[^=]", self._text) else ""
            raise self._fault(f"is no expression: {fault.msg}{hint}") from None
        except ValueError as fault:  # a NUL, or a number of thousands of digits
            raise self._fault(f"is no expression: {fault}") from None

    def _test(self, node: ast.expr) -> Test:
        """Return the test of runs that a node stands for: a connective, a comparison, or `like`."""
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
                return self._pattern_test(self._operand(name), pattern, node)
        raise self._fault(f"{self._source(node)} stands where one of {ALLOWED} was expected")

    def _comparison(self, left_node: ast.expr, relation: ast.cmpop, right_node: ast.expr) -> Test:
        """Return the test of one comparison of two operands, at least one of which is a name."""
        left_value, right_value = self._operand(left_node), self._operand(right_node)
        if not isinstance(left_value, NamedValue) and not isinstance(right_value, NamedValue):
            raise self._fault(
                f"{self._source(left_node)} and {self._source(right_node)} are compared, and neither is a name"
            )
        match relation:
            case ast.Is() | ast.IsNot():
                return self._none_test(left_value, right_value, isinstance(relation, ast.Is), right_node)
            case ast.In() | ast.NotIn():
                test = self._membership(left_value, right_value, right_node)
                if isinstance(relation, ast.In):
                    return test
                value = left_value.of if isinstance(left_value, NamedValue) else right_value.of
                return lambda run: value(run) is not None and not test(run)
        if not isinstance(left_value, NamedValue):
            assert isinstance(right_value, NamedValue)
            return self._relation(right_value, MIRRORED.get(type(relation), type(relation)), left_value, left_node)
        return self._relation(left_value, type(relation), right_value, right_node)

    def _relation(self, name: NamedValue, relation: type[ast.cmpop], operand: Any, node: ast.expr) -> Test:
        """Return the test that compares a run's value with another value of the run, or with a constant."""
        compare, value = RELATIONS[relation], name.of
        if isinstance(operand, NamedValue):
            other_value = operand.of
            return lambda run: _compared(compare, value(run), other_value(run))
        if name.kind == MOMENT:
            return self._in_time(name, relation, operand, node)
        self._refuse_kind(name, operand, node)
        return lambda run: _compared(compare, value(run), operand)

    def _in_time(self, name: NamedValue, relation: type[ast.cmpop], constant: Any, node: ast.expr) -> Test:
        """Return the test that compares the time of a run with a constant; a date stands for the whole day."""
        try:
            day_start, day_end = span_of(constant)
        except (ValueError, TypeError):
            expected = f"{name.text} is {MOMENT}, such as '2026-01-31' or '2026-01-31T13:00'"
            raise self._fault(f"{expected}; {self._source(node)} is none") from None
        value = name.of
        is_inside: Callable[[datetime], bool] = lambda moment: moment == day_start or day_start <= moment < day_end  # noqa: E731
        tests: dict[type[ast.cmpop], Callable[[datetime], bool]] = {
            ast.Eq: is_inside,
            ast.NotEq: lambda moment: not is_inside(moment),
            ast.Lt: lambda moment: moment < day_start,
            ast.LtE: lambda moment: moment < day_start or is_inside(moment),
            ast.Gt: lambda moment: moment > day_start and not is_inside(moment),
            ast.GtE: lambda moment: moment >= day_start,
        }
        test = tests[relation]
        return lambda run: (moment := value(run)) is not None and test(moment)

    def _membership(self, member: Any, container: Any, node: ast.expr) -> Test:
        """Return the test of `in`: a name in a list of constants, or a constant in a text or list of the run."""
        if isinstance(container, list) and isinstance(member, NamedValue):
            tests = [self._relation(member, ast.Eq, item, node) for item in container]
            return lambda run: any(test(run) for test in tests)
        if isinstance(container, NamedValue) and not isinstance(member, NamedValue):
            if container.kind in (NUMBER, MOMENT):
                raise self._fault(
                    f"{container.text} is {container.kind} and holds no others; it is compared by == or <"
                )
            value = container.of
            return lambda run: _contains(member, value(run))
        raise self._fault(
            f"{self._source(node)} stands after in, where a list such as ('a', 'b'), or the name of a text or of a list"
            " was expected"
        )

    def _none_test(self, left_value: Any, right_value: Any, is_none_wanted: bool, node: ast.expr) -> Test:
        """Return the test of `is None` (`is_none_wanted`) or of `is not None`."""
        if not isinstance(left_value, NamedValue) or right_value is not None:
            raise self._fault(f"is {self._source(node)}: NAME is None was expected; other values are compared by ==")
        value = left_value.of
        return lambda run: (value(run) is None) == is_none_wanted

    def _pattern_test(self, name: Any, pattern: str, node: ast.expr) -> Test:
        """Return the test of `like`: whether the text, or any of the texts, of a run matches a shell pattern."""
        if not isinstance(name, NamedValue) or name.kind in (NUMBER, MOMENT):
            raise self._fault(f"{self._source(node)}: the name of a text or of a list was expected first")
        matches, value = re.compile(translate(pattern)).match, name.of

        def test(run: Summary) -> bool:
            run_value = value(run)
            texts = run_value if isinstance(run_value, list | tuple) else [run_value]
            return any(isinstance(text, str) and matches(text) is not None for text in texts)

        return test

    def _operand(self, node: ast.expr) -> Any:
        """Return the operand of a node: a NamedValue, a text, a number, None, or a list of constants."""
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
        """Return the attribute of a run, or the parameter, that a name stands for."""
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

    def _hint(self, name: str, known_names: Collection[str]) -> str:
        """Return the known name that is closest to a wrong one, or else all known names, as the end of a message."""
        if similar_names := get_close_matches(name, known_names, n=1):
            return f"; did you mean {similar_names[0]!r}"
        names = sorted(known_names)
        others_text = f" and {len(names) - MOST_NAMES_SHOWN} more" if len(names) > MOST_NAMES_SHOWN else ""
        return f"; known: {', '.join(names[:MOST_NAMES_SHOWN]) or 'none'}{others_text}"

    def _refuse_kind(self, name: NamedValue, constant: Any, node: ast.expr) -> None:
        """Raise InputError if a name is compared with a constant of another kind than its values."""
        expected_types = {TEXT: str, NUMBER: (int, float), TEXTS: list}.get(name.kind, object)
        if constant is None:
            raise self._fault(f"{name.text} is compared with None; is None was expected")
        if not isinstance(constant, expected_types):  # type: ignore[arg-type]
            hint = f"; {self._source(node)} in {name.text} asks for a member" if name.kind == TEXTS else ""
            raise self._fault(f"{name.text} is {name.kind}; {self._source(node)} is none{hint}")

    def _source(self, node: ast.expr) -> str:
        """Return the text of a node in the expression, shortened for a message."""
        return _shortened(ast.get_source_segment(self._text.strip(), node) or "it")

    def _fault(self, reason: str) -> InputError:
        """Return the error for an expression that cannot be used."""
        return InputError(f"--where {_shortened(self._text)}: {reason}")


def _shortened(text: str) -> str:
    """Return a text on one line, cut to `MOST_CHARACTERS_SHOWN` characters."""
    line = " ".join(text.split())
    return line if len(line) <= MOST_CHARACTERS_SHOWN else f"{line[:MOST_CHARACTERS_SHOWN]} ..."


def _parameter(name: str) -> NamedValue:
    """Return the value of a protocol's parameter, by its name."""
    return NamedValue(name, "", lambda run: run.parameters.get(name))


def _compared(compare: Callable[[Any, Any], bool], value: Any, other_value: Any) -> bool:
    """Apply a comparison; values of different kinds (text, number, list) are unequal and have no order."""
    if value is None or other_value is None:
        return False
    numbers = isinstance(value, int | float), isinstance(other_value, int | float)
    if all(numbers) or (
        type(value) is type(other_value) and (isinstance(value, str) or compare in (operator.eq, operator.ne))
    ):
        return bool(compare(value, other_value))
    return compare is operator.ne


def _contains(value: Any, container: Any) -> bool:
    """Return whether a text contains a text, or a list a value."""
    if isinstance(container, str):
        return isinstance(value, str) and value in container
    return isinstance(container, list | tuple) and value in container
