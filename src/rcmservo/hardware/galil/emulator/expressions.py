"""Numbers and expressions of the controller's language.

Numbers have one type, with 32 bits before the point and 16 after it. Expressions have no operator
precedence and are evaluated from left to right:

    1+2*3 is 9        1+(2*3) is 7        a=5 as a comparison is 1 or 0

Sources: command reference, Mathematical operations and Operands; MG, PF, VF.
"""

import math
import re
from collections.abc import Callable, Sequence
from typing import Protocol

FRACTION_STEPS = 65536
"""Steps per unit: a number has 16 bits after the point."""

MAX_INTEGER = 2147483647
"""Largest integer: a number has 32 bits before the point."""


class CommandError(Exception):
    """Error of a command that the controller refuses.

    Parameters
    ----------
    code : int
        Error code that TC reports.
    """

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


def stored_number(value: float) -> float:
    """Round a number to the controller's resolution, or raise :class:`CommandError`."""
    if not -MAX_INTEGER - 1 <= value < MAX_INTEGER + 1:
        raise CommandError(6)
    return math.floor(value * FRACTION_STEPS) / FRACTION_STEPS


def format_number(value: float) -> str:
    """Format one number like MG and the question mark of a variable (VF 10.4)."""
    return f" {value:.4f}"


def format_list(values: Sequence[float], digits: int = 0) -> str:
    """Format several numbers like TP and similar commands (PF 10.0)."""
    return " " + ", ".join(f"{value:.{digits}f}" for value in values)


TOKEN = re.compile(
    r"\s*(?:(?P<hex>\$[0-9A-F]+)|(?P<number>\d+\.?\d*|\.\d+)|(?P<function>@[A-Z]+)"
    r"|(?P<operand>_[A-Z]{2}[A-Z0-9]{0,2})|(?P<name>[A-Za-z][A-Za-z0-9]{0,7})"
    r"|(?P<sign><>|<=|>=|[-+*/%&|=<>()\[\]]))"
)

Operation = Callable[[float, float], float]


def _divide(a: float, b: float) -> float:
    if b == 0.0:
        raise CommandError(6)
    return a / b


def _remainder(a: float, b: float) -> float:
    if b == 0.0:
        raise CommandError(6)
    return math.fmod(a, b)


OPERATIONS: dict[str, Operation] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": _divide,
    "%": _remainder,
    "&": lambda a, b: float(int(a) & int(b)),
    "|": lambda a, b: float(int(a) | int(b)),
    "=": lambda a, b: float(a == b),
    "<>": lambda a, b: float(a != b),
    "<": lambda a, b: float(a < b),
    ">": lambda a, b: float(a > b),
    "<=": lambda a, b: float(a <= b),
    ">=": lambda a, b: float(a >= b),
}

FUNCTIONS: dict[str, Callable[[float], float]] = {
    "@ABS": abs,
    "@INT": lambda a: float(math.trunc(a)),
    "@FRAC": lambda a: a - math.trunc(a),
    "@RND": lambda a: float(math.floor(a + 0.5)),
    "@SQR": lambda a: math.sqrt(abs(a)),
    "@SIN": lambda a: math.sin(math.radians(a)),
    "@COS": lambda a: math.cos(math.radians(a)),
    "@COM": lambda a: float(~int(a)),
}
"""Functions of one number. Angles are in degrees."""


class Symbols(Protocol):
    """Values of the names in an expression. An unknown name raises :class:`CommandError`."""

    def variable(self, name: str) -> float:
        """Return the value of a variable."""
        ...

    def element(self, name: str, index: float) -> float:
        """Return an element of an array."""
        ...

    def operand(self, name: str) -> float:
        """Return the value of an operand such as _TPA."""
        ...

    def input(self, function: str, number: float) -> float:
        """Return the value of @IN, @OUT or @AN for an input or output."""
        ...


def evaluate(text: str, symbols: Symbols) -> float:
    """Evaluate an expression."""
    parser = _Parser(_tokenise(text), symbols)
    value = parser.evaluate_chain()
    if not parser.at_end:
        raise CommandError(4 if parser.next_is(")") else 1)
    return stored_number(value)


def _tokenise(text: str) -> list[tuple[str, str]]:
    """Split an expression into tokens, each with its kind and text."""
    tokens: list[tuple[str, str]] = []
    at, text = 0, text.rstrip()
    while at < len(text):
        match = TOKEN.match(text, at)
        if match is None or match.lastgroup is None:
            raise CommandError(1)
        tokens.append((match.lastgroup, match.group(match.lastgroup)))
        at = match.end()
    return tokens


class _Parser:
    """Parser of a token list that evaluates the expression while it reads."""

    def __init__(self, tokens: list[tuple[str, str]], symbols: Symbols) -> None:
        self._tokens, self._at, self._symbols = tokens, 0, symbols

    @property
    def at_end(self) -> bool:
        return self._at == len(self._tokens)

    def next_is(self, sign: str) -> bool:
        return not self.at_end and self._tokens[self._at] == ("sign", sign)

    def evaluate_chain(self) -> float:
        """Evaluate terms and operators from left to right."""
        value = self._evaluate_term()
        while not self.at_end and self._tokens[self._at][1] in OPERATIONS:
            operation = OPERATIONS[self._take_token()[1]]
            value = stored_number(operation(value, self._evaluate_term()))
        return value

    def _take_token(self) -> tuple[str, str]:
        if self.at_end:
            raise CommandError(50)
        self._at += 1
        return self._tokens[self._at - 1]

    def _evaluate_term(self) -> float:
        kind, text = self._take_token()
        match kind:
            case "hex":
                return float(int(text[1:], 16))
            case "number":
                return stored_number(float(text))
            case "operand":
                return self._symbols.operand(text)
            case "function":
                return self._apply_function(text)
            case "name":
                return self._evaluate_name(text)
            case _:
                return self._evaluate_signed(text)

    def _evaluate_name(self, name: str) -> float:
        if self.next_is("["):
            return self._symbols.element(name, self._evaluate_enclosed("[", "]", 55))
        return self._symbols.variable(name)

    def _evaluate_signed(self, sign: str) -> float:
        if sign in "+-":
            return self._evaluate_term() if sign == "+" else -self._evaluate_term()
        if sign != "(":
            raise CommandError(1)
        self._at -= 1
        return self._evaluate_enclosed("(", ")", 59)

    def _apply_function(self, name: str) -> float:
        argument = self._evaluate_enclosed("[", "]", 55)
        if name in ("@IN", "@OUT", "@AN"):
            return self._symbols.input(name, argument)
        if name not in FUNCTIONS:
            raise CommandError(57)
        return FUNCTIONS[name](argument)

    def _evaluate_enclosed(self, opening: str, closing: str, code: int) -> float:
        """Evaluate an expression in brackets; a missing bracket raises the error of `code`."""
        if not self.next_is(opening):
            raise CommandError(code)
        self._at += 1
        value = self.evaluate_chain()
        if not self.next_is(closing):
            raise CommandError(code)
        self._at += 1
        return value
