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

from rcmservo.hardware.galil.emulator.state import CACHED_TEXTS, ControllerState
from rcmservo.hardware.galil.error_codes import CommandError, ErrorCode

FRACTION_STEPS = 65536
"""Steps per unit: a number has 16 bits after the point."""

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


Step = Callable[[list[float], ControllerState], None]
"""Step of an analysed expression: it replaces the newest numbers of a stack by its result."""


def evaluate(text: str, state: ControllerState) -> float:
    """Evaluate an expression, or raise :class:`CommandError`."""
    stack: list[float] = []
    for step in _analyse(text):
        step(stack, state)
    return stored_number(stack[0])


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
def _analyse(text: str) -> tuple[Step, ...]:
    """Return the steps that evaluate an expression from left to right.

    A syntax error is the last step, because the controller first evaluates what stands before it.
    """
    parser = _Parser(_tokenise(text))
    try:
        parser.read_all()
    except CommandError as error:
        parser.steps.append(_fail(error.code))
    return tuple(parser.steps)


def _tokenise(text: str) -> list[tuple[str, str]]:
    """Split an expression into tokens, each with its kind and text."""
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
    """Parser of a token list. ``steps`` are those of the part read so far."""

    def __init__(self, tokens: list[tuple[str, str]]) -> None:
        self._tokens, self._index = tokens, 0
        self.steps: list[Step] = []

    def read_all(self) -> None:
        """Read the whole expression."""
        self._read_chain()
        if self._next_is(")"):
            raise CommandError(ErrorCode.OPERAND_ERROR)
        if not self._at_end:
            raise CommandError(ErrorCode.UNRECOGNIZED_COMMAND)

    @property
    def _at_end(self) -> bool:
        return self._index == len(self._tokens)

    def _next_is(self, sign: str) -> bool:
        return not self._at_end and self._tokens[self._index] == ("sign", sign)

    def _read_chain(self) -> None:
        """Read terms and operators."""
        self._read_term()
        while not self._at_end and self._tokens[self._index][1] in OPERATIONS:
            sign = self._take_token()[1]
            self._read_term()
            self.steps.append(_combine(sign))

    def _take_token(self) -> tuple[str, str]:
        if self._at_end:
            raise CommandError(ErrorCode.NOT_ENOUGH_FIELDS)
        self._index += 1
        return self._tokens[self._index - 1]

    def _read_term(self) -> None:
        kind, text = self._take_token()
        match kind:
            case "hex":
                self.steps.append(_push(float(int(text[1:], 16))))
            case "number":
                self.steps.append(_push(stored_number(float(text))))
            case "operand":
                self.steps.append(lambda stack, state: stack.append(state.operand(text)))
            case "function":
                self._read_bracketed()
                self.steps.append(_apply(text))
            case "name":
                self._read_name(text)
            case _:
                self._read_signed(text)

    def _read_name(self, name: str) -> None:
        if self._next_is("["):
            self._read_bracketed()
            self.steps.append(lambda stack, state: stack.append(state.element(name, stack.pop())))
        else:
            self.steps.append(lambda stack, state: stack.append(state.variable(name)))

    def _read_signed(self, sign: str) -> None:
        """Read the rest of a term that begins with a sign or a parenthesis."""
        if sign in "+-":
            self._read_term()
            if sign == "-":
                self.steps.append(lambda stack, state: stack.append(-stack.pop()))
        elif sign == "(":
            self._read_up_to(")", ErrorCode.MISMATCHED_PARENTHESES)
        else:
            raise CommandError(ErrorCode.UNRECOGNIZED_COMMAND)

    def _read_bracketed(self) -> None:
        """Read an expression in square brackets."""
        if not self._next_is("["):
            raise CommandError(ErrorCode.MISSING_BRACKET)
        self._index += 1
        self._read_up_to("]", ErrorCode.MISSING_BRACKET)

    def _read_up_to(self, closing: str, code: ErrorCode) -> None:
        """Read an expression up to a closing sign; without it raise the error of `code`."""
        self._read_chain()
        if not self._next_is(closing):
            raise CommandError(code)
        self._index += 1


def _push(number: float) -> Step:
    """Return the step that adds a number to the stack."""
    return lambda stack, state: stack.append(number)


def _combine(sign: str) -> Step:
    """Return the step that combines the two newest numbers by an operation."""
    operation, divides = OPERATIONS[sign], sign in "/%"

    def combine(stack: list[float], state: ControllerState) -> None:
        operand = stack.pop()
        if divides and operand == 0.0:
            raise CommandError(ErrorCode.NUMBER_OUT_OF_RANGE)
        stack[-1] = stored_number(operation(stack[-1], operand))

    return combine


def _apply(name: str) -> Step:
    """Return the step that applies a function to the newest number."""

    def apply(stack: list[float], state: ControllerState) -> None:
        if name in ("@IN", "@OUT", "@AN"):
            stack[-1] = state.input(name, stack[-1])
        elif name in FUNCTIONS:
            stack[-1] = FUNCTIONS[name](stack[-1])
        else:
            raise CommandError(ErrorCode.BAD_FUNCTION_OR_ARRAY)

    return apply


def _fail(code: ErrorCode) -> Step:
    """Return the step that raises an error."""

    def fail(stack: list[float], state: ControllerState) -> None:
        raise CommandError(code)

    return fail
