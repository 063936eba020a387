"""Error codes with which a Galil controller refuses a command, and their texts.

Source: DMC-40x0 command reference, TC.
"""

from enum import IntEnum


class ErrorCode(IntEnum):
    """Code of the last error (TC). ``text`` is the controller's own text (TC1)."""

    text: str

    def __new__(cls, code: int, text: str) -> "ErrorCode":
        member = int.__new__(cls, code)
        member._value_, member.text = code, text
        return member

    UNRECOGNIZED_COMMAND = 1, "Unrecognized command"
    ONLY_FROM_PROGRAM = 2, "Command only valid from program"
    NOT_IN_PROGRAM = 3, "Command not valid in program"
    OPERAND_ERROR = 4, "Operand error"
    INPUT_BUFFER_FULL = 5, "Input buffer full"
    NUMBER_OUT_OF_RANGE = 6, "Number out of range"
    NOT_WHILE_RUNNING = 7, "Command not valid while running"
    NOT_WHILE_AT_REST = 8, "Command not valid while not running"
    VARIABLE_ERROR = 9, "Variable error"
    UNDEFINED_LABEL = 10, "Empty program line or undefined label"
    INVALID_LINE_NUMBER = 11, "Invalid label or line number"
    TOO_MANY_SUBROUTINES = 12, "Subroutine more than 16 deep"
    NOT_IN_JOG_MODE = 13, "JG only valid when running in jog mode"
    NOT_WHILE_PROGRAM_RUNS = 17, "ED, BN and DL not valid while program running"
    THREAD_ALREADY_RUNS = 19, "Application strand already executing"
    BEGIN_WITH_MOTOR_OFF = 20, "Begin not valid with motor off"
    BEGIN_WHILE_RUNNING = 21, "Begin not valid while running"
    BEGIN_AT_LIMIT = 22, "Begin not possible due to Limit Switch"
    NOT_ENOUGH_FIELDS = 50, "Not enough fields"
    QUESTION_MARK_NOT_VALID = 51, "Question mark not valid"
    STRING_TOO_LONG = 52, 'Missing " or string too long'
    ERROR_IN_BRACES = 53, "Error in {}"
    MISSING_BRACKET = 55, "Missing [ or []"
    INVALID_ARRAY_INDEX = 56, "Array index invalid or out of range"
    BAD_FUNCTION_OR_ARRAY = 57, "Bad function or array"
    BAD_COMMAND_RESPONSE = 58, "Bad command response (i.e._GNX)"
    MISMATCHED_PARENTHESES = 59, "Mismatched parentheses"
    DOWNLOAD_TOO_LONG = 60, "Download error - line too long or too many lines"
    BAD_LABEL = 61, "Duplicate or bad label"
    TOO_MANY_LABELS = 62, "Too many labels"
    MISSING_ENDIF = 63, "IF statement without ENDIF"
    ARRAY_SPACE_FULL = 66, "Array space full"
    TOO_MANY_VARIABLES = 67, "Too many arrays or variables"
    UNDEFINED_ARRAY = 82, "Undefined Array"
    NOT_A_NUMBER = 83, "Not a valid number"
    TCP_LOST_SYNC = 123, "TCP lost sync"
    HANDLE_MUST_BE_UDP = 133, "Command not valid when locked / Handle must be UDP"


ERROR_TEXTS = {code.value: code.text for code in ErrorCode}
"""Texts of the error codes, by number. A real controller can report further codes."""


class CommandError(Exception):
    """Error with which the emulated controller refuses a command.

    Parameters
    ----------
    code : ErrorCode
        Code that TC reports afterwards.
    """

    def __init__(self, code: ErrorCode) -> None:
        super().__init__(code)
        self.code = code
