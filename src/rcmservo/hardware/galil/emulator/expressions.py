"""Expressions of the controller's language: strictly from left to right, with no precedence.

    1+2*3 is 9        1+(2*3) is 7        a=5 as a comparison is 1 or 0

Source: command reference, Mathematical operations and Operands.
"""

import math
import re
from collections.abc import Callable
from typing import Protocol

from rcmservo.hardware.galil.emulator.numbers import Refusal, kept

TOKEN = re.compile(
    r"\s*(?:(?P<hex>\$[0-9A-F]+)|(?P<number>\d+\.?\d*|\.\d+)|(?P<function>@[A-Z]+)"
    r"|(?P<operand>_[A-Z]{2}[A-Z0-9]{0,2})|(?P<name>[A-Za-z][A-Za-z0-9]{0,7})"
    r"|(?P<sign><>|<=|>=|[-+*/%&|=<>()\[\]]))"
)

Operation = Callable[[float, float], float]


def _divided(a: float, b: float) -> float:
    if b == 0.0:
        raise Refusal(6)
    return a / b


def _rest(a: float, b: float) -> float:
    if b == 0.0:
        raise Refusal(6)
    return math.fmod(a, b)


OPERATIONS: dict[str, Operation] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": _divided,
    "%": _rest,
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
"""Of one number; angles in degrees."""


class Names(Protocol):
    """What the names in an expression stand for. Unknown ones are refused."""

    def variable(self, name: str) -> float:
        """A variable's value."""
        ...

    def element(self, name: str, index: float) -> float:
        """An array's element."""
        ...

    def operand(self, name: str) -> float:
        """What an operand such as _TPA tells."""
        ...

    def input(self, function: str, number: float) -> float:
        """What @IN, @OUT or @AN tells of an input or output."""
        ...


def value_of(text: str, names: Names) -> float:
    """The value of an expression."""
    reader = _Reader(_tokens(text), names)
    value = reader.chain()
    if not reader.done:
        raise Refusal(4 if reader.next_is(")") else 1)
    return kept(value)


def _tokens(text: str) -> list[tuple[str, str]]:
    """Kind and text of every word of an expression."""
    found: list[tuple[str, str]] = []
    at, text = 0, text.rstrip()
    while at < len(text):
        match = TOKEN.match(text, at)
        if match is None or match.lastgroup is None:
            raise Refusal(1)
        found.append((match.lastgroup, match.group(match.lastgroup)))
        at = match.end()
    return found


class _Reader:
    """Reads an expression's words one after the other."""

    def __init__(self, tokens: list[tuple[str, str]], names: Names) -> None:
        self._tokens, self._at, self._names = tokens, 0, names

    @property
    def done(self) -> bool:
        return self._at == len(self._tokens)

    def next_is(self, sign: str) -> bool:
        return not self.done and self._tokens[self._at] == ("sign", sign)

    def chain(self) -> float:
        """Terms and what stands between them, from left to right."""
        value = self._term()
        while not self.done and self._tokens[self._at][1] in OPERATIONS:
            operation = OPERATIONS[self._take()[1]]
            value = kept(operation(value, self._term()))
        return value

    def _take(self) -> tuple[str, str]:
        if self.done:
            raise Refusal(50)
        self._at += 1
        return self._tokens[self._at - 1]

    def _term(self) -> float:
        kind, text = self._take()
        match kind:
            case "hex":
                return float(int(text[1:], 16))
            case "number":
                return kept(float(text))
            case "operand":
                return self._names.operand(text)
            case "function":
                return self._function(text)
            case "name":
                return self._named(text)
            case _:
                return self._signed(text)

    def _named(self, name: str) -> float:
        if self.next_is("["):
            return self._names.element(name, self._within("[", "]", 55))
        return self._names.variable(name)

    def _signed(self, sign: str) -> float:
        if sign in "+-":
            return self._term() if sign == "+" else -self._term()
        if sign != "(":
            raise Refusal(1)
        self._at -= 1
        return self._within("(", ")", 59)

    def _function(self, name: str) -> float:
        argument = self._within("[", "]", 55)
        if name in ("@IN", "@OUT", "@AN"):
            return self._names.input(name, argument)
        if name not in FUNCTIONS:
            raise Refusal(57)
        return FUNCTIONS[name](argument)

    def _within(self, opening: str, closing: str, code: int) -> float:
        if not self.next_is(opening):
            raise Refusal(code)
        self._at += 1
        value = self.chain()
        if not self.next_is(closing):
            raise Refusal(code)
        self._at += 1
        return value
