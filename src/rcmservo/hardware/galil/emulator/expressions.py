"""Numbers and expressions of the controller's language.

Numbers have one type, with 32 bits before the point and 16 after it. Expressions have no operator
precedence and are evaluated from left to right:

    1+2*3 is 9        1+(2*3) is 7        a=5 as a comparison is 1 or 0

Sources: command reference, Mathematical operations and Operands; MG, PF, VF.
"""

import math
import operator
import re
from collections.abc import Callable, Sequence
from functools import lru_cache

from rcmservo.hardware.galil.emulator.state import ControllerState
from rcmservo.hardware.galil.error_codes import CommandError, ErrorCode

FRACTION_STEPS = 65536
"""Steps per unit: a number has 16 bits after the point."""

CACHED_TEXTS = 1024
"""Number of texts whose analysis is kept: a program repeats the same ones every 2 ms."""

MAX_INTEGER = 2147483647
"""Largest integer: a number has 32 bits before the point."""

TOKEN = re.compile(
    r"\s*(?:(?P<hex>\$[0-9A-F]+)|(?P<number>\d+\.?\d*|\.\d+)|(?P<function>@[A-Z]+)"
    r"|(?P<operand>_[A-Z]{2}[A-Z0-9]{0,2})|(?P<name>[A-Za-z][A-Za-z0-9]{0,7})"
    r"|(?P<sign><>|<=|>=|[-+*/%&|=<>()\[\]]))"
)

OPERATIONS: dict[str, Callable[[float, float], float]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "%": math.fmod,
    "&": lambda a, b: int(a) & int(b),
    "|": lambda a, b: int(a) | int(b),
    "=": operator.eq,
    "<>": operator.ne,
    "<": operator.lt,
    ">": operator.gt,
    "<=": operator.le,
    ">=": operator.ge,
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


def evaluate(text: str, state: ControllerState) -> float:
    """Evaluate an expression, or raise :class:`CommandError`."""
    parser = _Parser(_tokenise(text), state)
    value = parser.evaluate_chain()
    if parser.next_is(")"):
        raise CommandError(ErrorCode.OPERAND_ERROR)
    if not parser.at_end:
        raise CommandError(ErrorCode.UNRECOGNIZED_COMMAND)
    return stored_number(value)


def stored_number(value: float) -> float:
    """Round a number to the controller's resolution, or raise :class:`CommandError`."""
    if not -MAX_INTEGER - 1 <= value < MAX_INTEGER + 1:
        raise CommandError(ErrorCode.NUMBER_OUT_OF_RANGE)
    return math.floor(value * FRACTION_STEPS) / FRACTION_STEPS


def format_number(value: float) -> str:
    """Format one number like MG and the question mark of a variable (VF 10.4)."""
    return f" {value:.4f}"


def format_list(values: Sequence[float], digits: int = 0) -> str:
    """Format several numbers like TP and similar commands (PF 10.0)."""
    return " " + ", ".join(f"{value:.{digits}f}" for value in values)


@lru_cache(CACHED_TEXTS)
def _tokenise(text: str) -> list[tuple[str, str]]:
    """Split an expression into tokens, each with its kind and text. The list must not change."""
    tokens: list[tuple[str, str]] = []
    position, text = 0, text.rstrip()
    while position < len(text):
        match = TOKEN.match(text, position)
        if match is None or match.lastgroup is None:
            raise CommandError(ErrorCode.UNRECOGNIZED_COMMAND)
        tokens.append((match.lastgroup, match.group(match.lastgroup)))
        position = match.end()
    return tokens


class _Parser:
    """Parser of a token list that evaluates the expression while it reads."""

    def __init__(self, tokens: list[tuple[str, str]], state: ControllerState) -> None:
        self._tokens, self._index, self._state = tokens, 0, state

    @property
    def at_end(self) -> bool:
        return self._index == len(self._tokens)

    def next_is(self, sign: str) -> bool:
        return not self.at_end and self._tokens[self._index] == ("sign", sign)

    def evaluate_chain(self) -> float:
        """Evaluate terms and operators from left to right."""
        value = self._evaluate_term()
        while not self.at_end and self._tokens[self._index][1] in OPERATIONS:
            sign = self._take_token()[1]
            operand = self._evaluate_term()
            if sign in "/%" and operand == 0.0:
                raise CommandError(ErrorCode.NUMBER_OUT_OF_RANGE)
            value = stored_number(OPERATIONS[sign](value, operand))
        return value

    def _take_token(self) -> tuple[str, str]:
        if self.at_end:
            raise CommandError(ErrorCode.NOT_ENOUGH_FIELDS)
        self._index += 1
        return self._tokens[self._index - 1]

    def _evaluate_term(self) -> float:
        kind, text = self._take_token()
        match kind:
            case "hex":
                return float(int(text[1:], 16))
            case "number":
                return stored_number(float(text))
            case "operand":
                return self._state.operand(text)
            case "function":
                return self._apply_function(text)
            case "name":
                return self._evaluate_name(text)
            case _:
                return self._evaluate_signed(text)

    def _evaluate_name(self, name: str) -> float:
        if self.next_is("["):
            return self._state.element(name, self._evaluate_bracketed())
        return self._state.variable(name)

    def _evaluate_signed(self, sign: str) -> float:
        """Evaluate a term that begins with a sign or a parenthesis."""
        if sign in "+-":
            return self._evaluate_term() if sign == "+" else -self._evaluate_term()
        if sign != "(":
            raise CommandError(ErrorCode.UNRECOGNIZED_COMMAND)
        return self._evaluate_up_to(")", ErrorCode.MISMATCHED_PARENTHESES)

    def _apply_function(self, name: str) -> float:
        argument = self._evaluate_bracketed()
        if name in ("@IN", "@OUT", "@AN"):
            return self._state.input(name, argument)
        if name not in FUNCTIONS:
            raise CommandError(ErrorCode.BAD_FUNCTION_OR_ARRAY)
        return FUNCTIONS[name](argument)

    def _evaluate_bracketed(self) -> float:
        """Evaluate an expression in square brackets."""
        if not self.next_is("["):
            raise CommandError(ErrorCode.MISSING_BRACKET)
        self._index += 1
        return self._evaluate_up_to("]", ErrorCode.MISSING_BRACKET)

    def _evaluate_up_to(self, closing: str, code: ErrorCode) -> float:
        """Evaluate an expression up to a closing sign; without it raise the error of `code`."""
        value = self.evaluate_chain()
        if not self.next_is(closing):
            raise CommandError(code)
        self._index += 1
        return value
